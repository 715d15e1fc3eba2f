"""What jobs leave behind, by job and name, in any file system that fsspec knows; a local folder by
default."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from penumbra_service.store.files import CHUNK_BYTES, Files

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class NoSuchArtifactError(LookupError):
    """The job has no such artifact (yet)."""


@dataclass(frozen=True)
class ArtifactInfo:
    """What is known without reading. `etag` changes whenever the bytes do."""

    size: int
    etag: str


class Artifacts:
    """Files of jobs. An artifact is there wholly or not at all: it is written aside and then renamed."""

    def __init__(self, url: str) -> None:
        """`url` as fsspec takes it: a folder's path, memory://..., s3://bucket/prefix."""
        self._files = Files(url)

    def put(self, job_id: str, name: str, source: Path) -> None:
        """Stores the file `source`, which is left alone, replacing what was there. `name` may have folders."""
        self._files.write(self._path(job_id, name), source)

    def info(self, job_id: str, name: str) -> ArtifactInfo:
        """Raises NoSuchArtifactError."""
        try:
            found = self._files.system.info(self._path(job_id, name))
        except FileNotFoundError:
            raise NoSuchArtifactError(f"job {job_id} has no {name}") from None
        stamp = found.get("ETag") or found.get("mtime") or found.get("created") or found.get("LastModified")
        return ArtifactInfo(int(found["size"]), f"{stamp}-{found['size']}".replace('"', ""))

    def exists(self, job_id: str, name: str) -> bool:
        return bool(self._files.system.exists(self._path(job_id, name)))

    def local_path(self, job_id: str, name: str) -> Path | None:
        """Where the bytes lie if the file system is this machine's, else None. Raises NoSuchArtifactError."""
        self.info(job_id, name)
        return Path(self._path(job_id, name)) if self._files.local else None

    def read(self, job_id: str, name: str) -> Iterator[bytes]:
        """The bytes, in chunks. Raises NoSuchArtifactError before the first one."""
        self.info(job_id, name)
        with self._files.system.open(self._path(job_id, name), "rb") as reader:
            while chunk := reader.read(CHUNK_BYTES):
                yield chunk

    def remove(self, job_id: str) -> None:
        """Forgets everything of this job; nothing happens where there is nothing."""
        folder = self._path(job_id, "x")[:-2]
        if self._files.system.exists(folder):
            self._files.system.rm(folder, recursive=True)

    def _path(self, job_id: str, name: str) -> str:
        for part in (job_id, *name.split("/")):
            if _NAME.fullmatch(part) is None:
                raise NoSuchArtifactError(f"{part!r} is no name of an artifact")
        return f"{self._files.root}/{job_id}/{name}"
