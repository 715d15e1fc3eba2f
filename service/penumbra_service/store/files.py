"""Files in any file system that fsspec knows, whole or not there at all: a local folder, an S3-like store."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import fsspec
from fsspec.implementations.local import LocalFileSystem

from penumbra_service.store.ids import new_id

CHUNK_BYTES: Final = 1 << 20
PART: Final = ".part"
"""How names of files end that are still being written."""


class Files:
    """Below one place. Methods raise OSError where it cannot be reached."""

    def __init__(self, url: str) -> None:
        """`url` as fsspec takes it: a folder's path, memory://..., s3://bucket/prefix."""
        self.system: Any
        # Others write as well: what was listed once is no answer.
        self.system, root = fsspec.core.url_to_fs(url, use_listings_cache=False)
        self.root = str(root).rstrip("/")
        self.local = isinstance(self.system, LocalFileSystem)
        """Whether paths are this machine's own."""

    def write(self, path: str, source: Path) -> None:
        """Copy the file `source` there; what was there is replaced at once, or stays."""
        self.system.makedirs(path.rpartition("/")[0], exist_ok=True)
        # A store of objects shows one once it is whole; to rename there would be to copy. No two writers, of whatever
        # machine, share a name aside.
        aside = f"{path}.{new_id()}{PART}" if self.local else path
        try:
            with source.open("rb") as reader, self.system.open(aside, "wb") as writer:
                shutil.copyfileobj(reader, writer, CHUNK_BYTES)
            if self.local:
                Path(aside).replace(path)
        except BaseException:
            if self.local:
                Path(aside).unlink(missing_ok=True)
            raise

    def renew(self, path: str, source: Path) -> None:
        """Have `path`, whose bytes are those of `source`, be there and new."""
        if self.local:
            with contextlib.suppress(FileNotFoundError):
                os.utime(path)
                return
        self.write(path, source)

    def modified(self, path: str) -> datetime | None:
        """When a file was written last; None where there is none."""
        try:
            moment: datetime = self.system.modified(path)
        except FileNotFoundError:
            return None
        return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)

    def find(self) -> Iterator[tuple[str, datetime]]:
        """Every file and when it was written last."""
        if self.system.exists(self.root):
            for path in self.system.find(self.root):
                moment = self.modified(path)
                if moment is not None:
                    yield path, moment

    def remove(self, path: str) -> bool:
        """Whether there was such a file."""
        try:
            self.system.rm_file(path)
        except FileNotFoundError:
            return False
        return True
