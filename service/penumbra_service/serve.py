"""Runs the service, and makes the keys that guard it: what the command line calls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from penumbra_service.settings import Settings, load_settings
from penumbra_service.store.database import Database
from penumbra_service.store.keys import ApiKey, KeyStore


def run(host: str | None = None, port: int | None = None, data: Path | None = None, **settings: Any) -> int:
    """Serves until SIGINT or SIGTERM and returns the exit status; first the running job writes its snapshot.

    Arguments are settings (penumbra_service.settings); None leaves one to the environment or its default.
    Raises SettingsError, PublicWithoutKeyError, and OSError where the address cannot be had.
    """
    from penumbra_service.serving import serve

    return serve(load_settings({"host": host, "port": port, "data": data, **settings}))


def create_key(
    name: str, data: Path | None = None, quota_seconds: float | None = None, **settings: Any
) -> tuple[str, ApiKey]:
    """A new API key: its text, which is shown this once, and what is kept of it."""
    with _keys(load_settings({"data": data, **settings})) as keys:
        return keys.create(name, quota_seconds)


def set_quota(id_or_name: str, quota_seconds: float | None, data: Path | None = None, **settings: Any) -> int:
    """Limits the device-seconds of the active keys of this identifier or name; how many that were."""
    with _keys(load_settings({"data": data, **settings})) as keys:
        return keys.set_quota(id_or_name, quota_seconds)


def revoke_key(id_or_name: str, data: Path | None = None, **settings: Any) -> int:
    """Ends the key with this identifier, or all of this name; how many that were."""
    with _keys(load_settings({"data": data, **settings})) as keys:
        return keys.revoke(id_or_name)


def list_keys(data: Path | None = None, **settings: Any) -> list[ApiKey]:
    """Every key, the oldest first, revoked ones too."""
    with _keys(load_settings({"data": data, **settings})) as keys:
        return keys.list()


@contextmanager
def _keys(settings: Settings) -> Iterator[KeyStore]:
    database = Database(settings.database)
    try:
        database.migrate()
        yield KeyStore(database)
    finally:
        database.close()
