"""Assets by content: an upload is hashed while it streams in, and its SHA-256 is its only name."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, Final

from sqlalchemy import delete, insert, select

from penumbra_service.store.content import NoSuchAssetError, asset_file
from penumbra_service.store.database import Database
from penumbra_service.store.schema import assets

_UPLOAD: Final = ".upload-"
"""How names of unfinished uploads begin."""


class AssetTooLargeError(ValueError):
    """The upload passed the limit; `limit` is in bytes."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"an asset may have at most {limit} bytes")
        self.limit = limit


class AssetDigestError(ValueError):
    """The bytes have another SHA-256 than the caller said."""

    def __init__(self, expected: str, actual: str) -> None:
        super().__init__(f"the bytes have SHA-256 {actual}, but {expected} was announced")
        self.expected, self.actual = expected, actual


@dataclass(frozen=True)
class StoredAsset:
    """An asset that is here. `sha256` is 64 hexadecimal digits, without prefix."""

    sha256: str
    bytes: int
    kind: str
    """image or mesh."""
    format: str
    detail: str
    """Its size in words."""
    created: datetime = field(default_factory=lambda: datetime.now(UTC))


class Upload:
    """Bytes on their way in: `write` them, then `AssetStore.place` files them."""

    def __init__(self, path: Path, limit: int) -> None:
        self._file = path.open("wb")
        self._limit = limit
        self._hash = hashlib.sha256()
        self.path = path
        self.size = 0

    def write(self, chunk: bytes) -> None:
        """Raises AssetTooLargeError as soon as the limit is passed."""
        self.size += len(chunk)
        if self.size > self._limit:
            raise AssetTooLargeError(self._limit)
        self._hash.update(chunk)
        self._file.write(chunk)

    def close(self, durable: bool = False) -> None:
        if durable and not self._file.closed:
            self._file.flush()
            os.fsync(self._file.fileno())
        self._file.close()

    @property
    def sha256(self) -> str:
        return self._hash.hexdigest()


class AssetStore:
    """Keeps assets in a folder, a file for each, and a row for each in the database."""

    def __init__(self, database: Database, folder: Path, max_bytes: int) -> None:
        self._database = database
        self._folder = folder
        self._max_bytes = max_bytes
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def folder(self) -> Path:
        """Its files are named by `asset_file`, which is all that a decoder needs to know."""
        return self._folder

    @contextmanager
    def upload(self) -> Iterator[Upload]:
        """A place to write to; whatever is not handed to `place` is forgotten."""
        handle, name = tempfile.mkstemp(prefix=_UPLOAD, dir=self._folder)
        os.close(handle)
        upload = Upload(Path(name), self._max_bytes)
        try:
            yield upload
        finally:
            upload.close()
            upload.path.unlink(missing_ok=True)

    def sweep(self, older_seconds: float = 0.0) -> None:
        """Removes uploads that an earlier process did not live to finish: those that were not written to for so
        long. None younger may be under way where it is 0."""
        for path in self._folder.glob(f"{_UPLOAD}*"):
            with contextlib.suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime >= older_seconds:
                    path.unlink()

    def before(self, moment: datetime) -> list[StoredAsset]:
        """Assets that were uploaded before a moment."""
        with self._database.read() as connection:
            return [
                _asset(row) for row in connection.execute(select(assets).where(assets.c.created < moment))
            ]

    def remove(self, sha256: str) -> None:
        """Forgets an asset."""
        with self._database.write() as connection:
            connection.execute(delete(assets).where(assets.c.sha256 == sha256))
        asset_file(self._folder, sha256).unlink(missing_ok=True)

    def place(self, upload: Upload, expected: str | None = None) -> bool:
        """Files the bytes under their digest; whether they are new. Raises AssetDigestError.

        The asset counts as stored only once `record` has told what it is.
        """
        if expected is not None and expected != upload.sha256:
            raise AssetDigestError(expected, upload.sha256)
        upload.close(durable=True)
        target = asset_file(self._folder, upload.sha256)
        if target.is_file():
            return False
        target.parent.mkdir(exist_ok=True)
        upload.path.replace(target)
        return True

    def open_placed(self, sha256: str) -> BinaryIO:
        """The bytes of an asset that was placed. Raises FileNotFoundError."""
        return asset_file(self._folder, sha256).open("rb")

    def record(self, asset: StoredAsset, owner: str | None = None) -> tuple[StoredAsset, bool]:
        """Writes down what the bytes are; the asset as it is known, and whether it was unknown before."""
        with self._database.write() as connection:
            row = connection.execute(_by_digest(asset.sha256)).one_or_none()
            if row is not None:
                return _asset(row), False
            connection.execute(insert(assets).values(**asdict(asset), owner=owner))
            return asset, True

    def discard(self, sha256: str) -> None:
        """Removes the bytes of an asset that was placed and turned out to be broken; a recorded one stays."""
        try:
            self.get(sha256)
        except NoSuchAssetError:
            asset_file(self._folder, sha256).unlink(missing_ok=True)

    def get(self, sha256: str) -> StoredAsset:
        """Raises NoSuchAssetError."""
        file = asset_file(self._folder, sha256)
        with self._database.read() as connection:
            row = connection.execute(_by_digest(sha256)).one_or_none()
        if row is None or not file.is_file():
            raise NoSuchAssetError(sha256)
        return _asset(row)

    def path(self, sha256: str) -> Path:
        """Where the bytes lie. Raises NoSuchAssetError."""
        self.get(sha256)
        return asset_file(self._folder, sha256)


def _by_digest(sha256: str) -> Any:
    return select(assets).where(assets.c.sha256 == sha256)


def _asset(row: Any) -> StoredAsset:
    return StoredAsset(row.sha256, row.bytes, row.kind, row.format, row.detail, row.created)
