"""Decoded assets, from a folder of content-addressed files and, on the command line, files beside the scene.

Decoding happens in a process of its own under limits, and its result is kept on disk by the file's
SHA-256, so that a file is decoded once and a broken one harms nobody.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import AssetError, Image, MeshData
from penumbra_scene.assets import AssetRef

from penumbra_service.images import formats
from penumbra_service.images.decode import REFUSED
from penumbra_service.images.limits import DecodeLimits
from penumbra_service.store.content import NoSuchAssetError, asset_file

CACHE_VERSION: Final = 1
"""Raise it when decoding changes, so that what older versions kept is decoded anew."""
_MESSAGE_LENGTH: Final = 500


class FolderAssets:
    """Implements penumbra_kernels.assets.Assets. Arrays are memory-mapped and read-only."""

    def __init__(
        self,
        folder: Path,
        scene_folder: Path | None = None,
        *,
        cache: Path | None = None,
        limits: DecodeLimits | None = None,
    ) -> None:
        """`folder` holds assets by content; `scene_folder`, where given, is what `file` references are
        relative to."""
        self._folder = folder
        self._scene_folder = scene_folder
        self._cache = cache or folder / ".decoded"
        self._limits = limits or DecodeLimits()

    def image(self, ref: AssetRef) -> Image:
        """Raises AssetError."""
        arrays = self._decoded(ref, "image")
        return Image(arrays["pixels"], bool(arrays["eight_bit"]))

    def mesh(self, ref: AssetRef) -> MeshData:
        """Raises AssetError."""
        arrays = self._decoded(ref, "mesh")
        return MeshData(arrays["positions"], arrays["indices"], arrays.get("normals"), arrays.get("uvs"))

    def _decoded(self, ref: AssetRef, kind: str) -> dict[str, NDArray[Any]]:
        try:
            path = self._path(ref)
            digest = ref.asset.removeprefix("sha256:") if ref.asset else self._digest(path)
            kept = self._cache / f"v{CACHE_VERSION}" / kind / digest
            if not _is_entry(kept):
                self._decode(path, kind, kept)
            with contextlib.suppress(OSError):
                os.utime(kept)  # used just now: housekeeping removes what was not for long
            return {file.stem: np.load(file, mmap_mode="r") for file in kept.glob("*.npy")}
        except AssetError as error:
            raise AssetError(f"{_title(ref, kind)}: {error}") from None
        except OSError as error:
            raise AssetError(f"{_title(ref, kind)}: cannot be read ({error.strerror or error})") from None

    def _path(self, ref: AssetRef) -> Path:
        if ref.asset is not None:
            try:
                path = asset_file(self._folder, ref.asset.removeprefix("sha256:"))
            except NoSuchAssetError:
                raise AssetError("is not a SHA-256") from None
            if not path.is_file():
                raise AssetError("is not here; upload it first")
            return path
        return self._beside_scene(ref.file or "")

    def _beside_scene(self, name: str) -> Path:
        if self._scene_folder is None:
            raise AssetError("files are accepted on the command line only; upload it and name its sha256")
        root = self._scene_folder.resolve()
        path = (root / name).resolve()
        if not path.is_relative_to(root):
            raise AssetError("lies outside the scene's folder")
        if not path.is_file():
            raise AssetError(f"there is no such file in {root}")
        return path

    def _digest(self, path: Path) -> str:
        self._check_size(path)
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _check_size(self, path: Path) -> None:
        size = path.stat().st_size
        if size > self._limits.file_bytes:
            raise AssetError(f"has {size} bytes; at most {self._limits.file_bytes} are accepted")

    def _decode(self, path: Path, kind: str, kept: Path) -> None:
        self._check_size(path)
        format_name = _format(path, kind)
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".decoding-", dir=kept.parent) as work:
            source, out = Path(work) / f"source.{format_name}", Path(work) / "out"
            source.symlink_to(path.resolve())  # a decoder that goes by names gets the true one
            out.mkdir()
            task = {"kind": kind, "format": format_name, "path": str(source), "out": str(out)}
            self._run({**task, "limits": asdict(self._limits)})
            if not _is_entry(kept):
                _remove(kept)
            try:
                out.rename(kept)
            except OSError:
                if not _is_entry(kept):  # else another process was faster, with the same result
                    raise
                shutil.rmtree(out)

    def _run(self, task: dict[str, Any]) -> None:
        try:
            done = subprocess.run(
                [sys.executable, "-m", "penumbra_service.images.decode"],
                input=json.dumps(task),
                capture_output=True,
                text=True,
                errors="replace",
                timeout=self._limits.seconds,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OIIO_THREADS": "1"},
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise AssetError(f"decoding it takes more than {self._limits.seconds:g} s") from None
        if done.returncode == REFUSED:
            raise AssetError(done.stdout.strip()[:_MESSAGE_LENGTH])
        if done.returncode != 0:
            raise AssetError(
                f"its decoder died ({_end(done.returncode)}): the file is broken, or takes more than "
                f"{self._limits.memory_bytes >> 20} MiB of memory"
            )


def _is_entry(kept: Path) -> bool:
    """Whether arrays lie there: an entry appears with all of its own."""
    return next(kept.glob("*.npy"), None) is not None


def _remove(path: Path) -> None:
    """What is in an entry's place and is none."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def decoded_entries(assets_folder: Path) -> list[Path]:
    """Decoded copies of assets: a folder for each, whose time of change is that of its last use."""
    cache = assets_folder / ".decoded"
    return [path for path in cache.glob("v*/*/*") if path.is_dir() and not path.name.startswith(".")]


def _format(path: Path, kind: str) -> str:
    with path.open("rb") as file:
        head = file.read(formats.HEAD_BYTES)
    if not head:
        raise AssetError("the file is empty")
    found = formats.image_format(head) if kind == "image" else formats.mesh_format(head)
    if found is None:
        accepted = formats.IMAGE_FORMATS if kind == "image" else formats.MESH_FORMATS
        raise AssetError(f"its content is none of the accepted formats: {accepted}")
    return found


def _title(ref: AssetRef, kind: str) -> str:
    return f"{kind} {ref.asset or ref.file}"


def _end(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"code {code}"
