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
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from penumbra_service.store.content import asset_file
from penumbra_service.store.files import CHUNK_BYTES, PART, Files

RENEW: Final = timedelta(hours=6)
"""What is put again so long after the last time counts as used from then on: far sooner than anything is removed."""
UPLOAD: Final = timedelta(days=1)
"""What is still being written is left alone for so long."""
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
        self._files = Files(url)

    def put(self, sha256: str, source: Path) -> None:
        """Store `source` under its digest, unless it is there, and have it count as used just now (to within RENEW). It
        appears wholly or not at all."""
        path = self._path(sha256)
        used = self._files.modified(path)
        if used is None or used < datetime.now(UTC) - RENEW:
            self._files.renew(path, source)

    def remove_unused(self, before: datetime) -> int:
        """Remove what nobody has put since then, and what a killed process left half written; how many files that were.
        Others may put and remove at the same time: what is put again meanwhile stays, or comes back with the next put."""
        dead = min(before, datetime.now(UTC) - UPLOAD)
        removed = 0
        for path, used in self._files.find():
            limit = dead if path.endswith(PART) else before
            # Asked once more: the list may be old by now.
            if used < limit and (self._files.modified(path) or limit) < limit:
                removed += self._files.remove(path)
        return removed

    def fetch(self, sha256: str, folder: Path) -> Path:
        """The file's copy in `folder`, filed as assets are; fetched unless it is there. Raises
        BrokenContentError, FileNotFoundError."""
        target = asset_file(folder, sha256)
        if target.is_dir():  # not of our making
            shutil.rmtree(target)
        with contextlib.suppress(FileNotFoundError):
            os.utime(target)  # used just now: the oldest are removed first
            return target
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".fetch-", dir=target.parent)
        try:
            with (
                os.fdopen(handle, "wb") as writer,
                self._files.system.open(self._path(sha256), "rb") as reader,
            ):
                shutil.copyfileobj(reader, writer, CHUNK_BYTES)
            if digest_of(Path(name)) != sha256:
                raise BrokenContentError(f"the bytes of {self._path(sha256)} have another SHA-256")
            Path(name).replace(target)
        finally:
            Path(name).unlink(missing_ok=True)
        return target

    def _path(self, sha256: str) -> str:
        return str(asset_file(Path(self._files.root), sha256))


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
