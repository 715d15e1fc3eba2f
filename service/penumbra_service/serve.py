"""Runs the service, and makes the keys that guard it: what the command line calls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn

from penumbra_service.app import create_app
from penumbra_service.settings import Settings, load_settings
from penumbra_service.store.database import Database
from penumbra_service.store.keys import ApiKey, KeyStore


def run(host: str | None = None, port: int | None = None, data: Path | None = None, **settings: Any) -> None:
    """Serves until SIGINT or SIGTERM; the running job's snapshot is written before it returns.

    Arguments are settings (penumbra_service.settings); None leaves one to its environment variable or default.
    Raises SettingsError, PublicWithoutKeyError; SystemExit where the port is taken.
    """
    chosen = load_settings({"host": host, "port": port, "data": data, **settings})
    config = uvicorn.Config(
        create_app(chosen),
        host=chosen.host,
        port=chosen.port,
        log_level=chosen.log_level,
        access_log=chosen.log_level == "debug",
        server_header=False,
        timeout_graceful_shutdown=5,
    )
    uvicorn.Server(config).run()


def create_key(name: str, data: Path | None = None, **settings: Any) -> tuple[str, ApiKey]:
    """A new API key: its text, which is shown this once, and what is kept of it."""
    with _keys(load_settings({"data": data, **settings})) as keys:
        return keys.create(name)


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
