"""Files by content in any file system that fsspec knows: how scenes and assets reach the workers of a farm.

A file's name is its SHA-256, so that it never changes, and what arrives is checked against it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import Any, Final

import fsspec

from penumbra_service.store.content import asset_file

CHUNK_BYTES: Final = 1 << 20
FOLDER: Final = "contents"
"""Within the artifact store."""


class BrokenContentError(OSError):
    """The store's bytes are not those that their name says."""


def contents_url(artifacts: str) -> str:
    """The place of files by content in the artifact store `artifacts`."""
    return f"{artifacts.rstrip('/')}/{FOLDER}"


def digest_of(path: Path) -> str:
    """SHA-256 of a file, 64 hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class ContentStore:
    """Methods raise OSError where the store cannot be reached."""

    def __init__(self, url: str) -> None:
        """`url` as fsspec takes it: a folder's path, s3://bucket/prefix."""
        self._files: Any
        self._files, root = fsspec.core.url_to_fs(url)
        self._root = str(root).rstrip("/")

    def put(self, sha256: str, source: Path) -> None:
        """Store `source` under its digest, unless it is there. It appears wholly or not at all."""
        path = self._path(sha256)
        if self._files.exists(path):
            return
        self._files.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
        aside = f"{path}.{os.getpid()}.part"
        with source.open("rb") as reader, self._files.open(aside, "wb") as writer:
            shutil.copyfileobj(reader, writer, CHUNK_BYTES)
        self._files.mv(aside, path)

    def fetch(self, sha256: str, folder: Path) -> Path:
        """The file's copy in `folder`, filed as assets are; fetched unless it is there. Raises
        BrokenContentError, FileNotFoundError."""
        target = asset_file(folder, sha256)
        with contextlib.suppress(FileNotFoundError):
            os.utime(target)  # used just now: the oldest are removed first
            return target
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".fetch-", dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as writer, self._files.open(self._path(sha256), "rb") as reader:
                shutil.copyfileobj(reader, writer, CHUNK_BYTES)
            if digest_of(Path(name)) != sha256:
                raise BrokenContentError(f"the bytes of {self._path(sha256)} have another SHA-256")
            Path(name).replace(target)
        finally:
            Path(name).unlink(missing_ok=True)
        return target

    def _path(self, sha256: str) -> str:
        return str(asset_file(Path(self._root), sha256))


def trim(folder: Path, max_bytes: int, keep: Collection[Path] = ()) -> None:
    """Remove the files of a folder of fetched contents that were used the longest ago, until it holds no more than
    `max_bytes`; those of `keep` stay."""
    found = []
    for path in folder.glob("??/*"):
        with contextlib.suppress(OSError):
            status = path.stat()
            found.append((status.st_mtime, status.st_size, path))
    held = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if held <= max_bytes:
            return
        if path not in keep:
            with contextlib.suppress(OSError):
                path.unlink()
                held -= size
