"""Opens the database and brings its tables up to date. SQLite by default; any SQLAlchemy URL otherwise.

SQLite runs with a write-ahead log, synchronous NORMAL (a power cut may lose the last commits, never
corrupt), a busy timeout, and BEGIN IMMEDIATE for writers: a transaction that reads before it writes must
hold the write lock from its start, since a busy timeout cannot help a deferred one to upgrade.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from pydantic_core import from_json
from sqlalchemy import Connection, Engine, create_engine, event, inspect, make_url
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError

from penumbra_service.store.room import is_full

log = logging.getLogger(__name__)

BUSY_MILLISECONDS: Final = 10_000
MIGRATIONS: Final = Path(__file__).parent / "migrations"
MIGRATION_LOCK: Final = 0x50454E554D425241
"""Any number that nobody else takes for a lock of this database: "PENUMBRA" in ASCII."""
_WRITES: Final = "penumbra_writes"
_STAMP: Final = "alembic_version"
"""Alembic's table, which holds the revision that a database is at."""


class Database:
    """One engine, and the two kinds of transaction that the stores use."""

    def __init__(self, url: str) -> None:
        self.engine = _engine(url)
        self._writer = self.engine.execution_options(**{_WRITES: True})

    def migrate(self, version: str = "head") -> None:
        """Runs every migration up to `version` that this database has not seen yet. Of several services that start at
        once the first does it; the others wait."""
        if version == "head" and self.revision() == newest_revision():
            return  # without the time that Alembic takes to be imported
        from alembic import command
        from alembic.config import Config

        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
        with self.write() as connection:
            if self.engine.dialect.name == "postgresql":
                connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({MIGRATION_LOCK})")
            config.attributes["connection"] = connection
            command.upgrade(config, version)

    def revision(self) -> str | None:
        """That of its tables; None where it has none yet."""
        with self.read() as connection:
            if not inspect(connection).has_table(_STAMP):
                return None
            return connection.exec_driver_sql(f"SELECT version_num FROM {_STAMP}").scalar()

    @contextmanager
    def read(self) -> Iterator[Connection]:
        with self.engine.begin() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Commits at the end, rolls back on an exception; other writers wait."""
        with self._writer.begin() as connection:
            yield connection

    def close(self) -> None:
        self.engine.dispose()


def newest_revision() -> str:
    """The last migration's: files are named by their revisions, in order."""
    return max(path.name.partition("_")[0] for path in (MIGRATIONS / "versions").glob("[0-9]*.py"))


def is_passing(error: BaseException) -> bool:
    """Whether the same may work in a moment: a connection was dropped, the server restarts, another holds the lock, the
    disk is full."""
    return (
        isinstance(error, OperationalError | InterfaceError)
        or (isinstance(error, DBAPIError) and error.connection_invalidated)
        or is_full(error)
    )


def gently(tell: Callable[[], None]) -> None:
    """News for the ledger, or a new picture: where it cannot be written just now, the next will do."""
    try:
        tell()
    except Exception as error:
        if not is_passing(error):
            raise
        log.warning("the ledger cannot be written: %s", error)


def _engine(url: str) -> Engine:
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        return create_engine(parsed, pool_pre_ping=True, json_deserializer=from_json)
    if parsed.database and parsed.database != ":memory:":
        Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
    wait = {"timeout": BUSY_MILLISECONDS / 1000}
    engine = create_engine(parsed, connect_args=wait, json_deserializer=from_json)
    event.listen(engine, "connect", _configure_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _configure_sqlite(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # the driver must not begin transactions of its own
    cursor = connection.cursor()
    for pragma in (
        f"busy_timeout = {BUSY_MILLISECONDS}",
        "journal_mode = WAL",
        "synchronous = NORMAL",
        "foreign_keys = ON",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get(_WRITES, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
