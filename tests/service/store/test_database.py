"""The database: settings, migrations, identifiers."""

from __future__ import annotations

import threading
from datetime import UTC, datetime
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from penumbra_service.store.database import MIGRATIONS, Database, newest_revision
from penumbra_service.store.ids import LENGTH, IdMaker, encode, is_id, new_id
from penumbra_service.store.jobs import NewJob, SqlJobStore
from penumbra_service.store.keys import PREFIX, KeyNameError, KeyStore
from penumbra_service.store.schema import jobs, metadata
from sqlalchemy import func, select


def test_sqlite_is_set_up_for_several_writers(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    with database.read() as connection:
        pragma = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar_one()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    database.close()
    assert pragma == {"journal_mode": "wal", "synchronous": 1, "foreign_keys": 1, "busy_timeout": 10_000}


def test_migrations_lead_to_the_tables_in_use(database: Database) -> None:
    with database.read() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []


def test_a_folder_is_made_for_sqlite(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'deep' / 'a.sqlite3'}")
    database.migrate()
    database.close()


def test_every_version_leads_to_the_newest_and_keeps_what_is_there(database_url: str) -> None:
    """Up from the first version, one step at a time, with a job, a key and an asset in the tables."""
    database = Database(database_url)
    database.migrate("0001")
    job = new_id()
    now = (
        "2025-01-02 03:04:05+00:00"
        if database.engine.dialect.name == "postgresql"
        else "2025-01-02 03:04:05.000000"
    )
    with database.write() as connection:
        connection.exec_driver_sql(
            f"INSERT INTO api_keys (id, name, digest, hint, created) VALUES ('K', 'laptop', 'abc', 'pnb_', '{now}')"
        )
        connection.exec_driver_sql(
            "INSERT INTO jobs (id, state, priority, name, request, progress, revision, crashes, owner, body_digest, "
            f"created, updated) VALUES ('{job}', 'done', 0, 'old', '{{}}', '{{\"width\": 5}}', 3, 0, 'K', 'd', "
            f"'{now}', '{now}')"
        )
        connection.exec_driver_sql(
            "INSERT INTO assets (sha256, bytes, kind, format, detail, created) "
            f"VALUES ('a', 1, 'mesh', 'obj', '1 triangle', '{now}')"
        )
    scripts = ScriptDirectory(str(MIGRATIONS))
    versions = [script.revision for script in reversed(list(scripts.walk_revisions()))]
    assert versions[0] == "0001"
    for version in versions[1:]:
        database.migrate(version)
    database.migrate()
    row = SqlJobStore(database).get(job)
    assert (row.name, row.progress, row.holder) == ("old", {"width": 5}, None)
    assert SqlJobStore(database).request(job) == "{}"
    assert row.created == datetime(2025, 1, 2, 3, 4, 5, tzinfo=UTC)
    (key,) = KeyStore(database).list()
    assert (key.name, key.quota_seconds, key.used_seconds, key.exhausted) == ("laptop", None, 0.0, False)
    with database.read() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []
    database.close()


def test_migrating_twice_changes_nothing(database_url: str) -> None:
    for _ in range(2):
        database = Database(database_url)
        database.migrate()
        SqlJobStore(database).create(NewJob("{}", "d" * 64, "kept"))
        database.close()
    with database.read() as connection:
        assert connection.execute(select(func.count()).select_from(jobs)).scalar_one() == 2
    database.close()


def test_the_newest_migration_is_alembics_head(database: Database) -> None:
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    assert newest_revision() == ScriptDirectory.from_config(config).get_current_head()
    assert database.revision() == newest_revision()


def test_a_database_of_an_older_version_is_migrated(database_url: str) -> None:
    database = Database(database_url)
    assert database.revision() is None
    database.migrate()
    with database.write() as connection:
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
        config.attributes["connection"] = connection
        command.downgrade(config, "0001")
    assert database.revision() == "0001"
    database.migrate()
    assert database.revision() == newest_revision()
    database.close()


def test_a_failed_transaction_leaves_nothing(database: Database) -> None:
    store = SqlJobStore(database)
    store.create(NewJob("{}", "d" * 64, "a"))

    def fail() -> None:
        with database.write() as connection:
            connection.execute(jobs.delete())
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert store.counts() == {"queued": 1}


def test_a_writer_waits_for_another(database: Database) -> None:
    """Read, then write, in four threads: deferred transactions would end as 'database is locked'."""
    store = SqlJobStore(database)
    row, _ = store.create(NewJob("{}", "d" * 64, "a", progress={"count": 0}))

    def add() -> None:
        for _ in range(20):
            with database.write() as connection:
                count = connection.execute(select(jobs.c.progress).with_for_update()).scalar_one()["count"]
                connection.execute(jobs.update().values(progress={"count": count + 1}))

    threads = [threading.Thread(target=add) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert store.get(row.id).progress == {"count": 80}


def test_identifiers_rise_and_tell_themselves_from_others() -> None:
    make = IdMaker()
    made = [make() for _ in range(2000)]
    assert made == sorted(set(made))
    assert all(is_id(text) and len(text) == LENGTH for text in made)
    assert encode(0) == "0" * 26
    assert encode(2**128 - 1) == "7" + "Z" * 25
    for text in ("", "x" * 26, made[0].lower(), made[0] + "0", "8" + "0" * 25, made[0][:-1] + "\n"):
        assert not is_id(text)


def test_keys_are_checked_listed_and_revoked(database: Database) -> None:
    keys = KeyStore(database)
    assert not keys.any_made()
    token, key = keys.create("a")
    other, _ = keys.create("b")
    assert token.startswith(PREFIX)
    assert token != other
    found = keys.check(token)
    assert found is not None
    assert found.id == key.id
    for wrong in ("", "pnb_", token[:-1], token + "x", token.upper()):
        assert keys.check(wrong) is None
    assert keys.revoke(key.id) == 1
    assert keys.check(token) is None
    assert keys.check(other) is not None
    assert keys.any_active()
    assert keys.revoke("b") == 1
    assert keys.revoke("b") == 0
    assert not keys.any_active()
    assert keys.any_made()
    assert [k.revoked is not None for k in keys.list()] == [True, True]


@pytest.mark.parametrize("name", ["", "x" * 201, "a\nb"])
def test_keys_have_names_that_can_be_read(database: Database, name: str) -> None:
    with pytest.raises(KeyNameError, match="1 to 200 printable"):
        KeyStore(database).create(name)


def test_a_name_is_one_active_keys(database: Database) -> None:
    keys = KeyStore(database)
    keys.create("laptop")
    with pytest.raises(KeyNameError, match="already"):
        keys.create("laptop")
    assert keys.revoke("laptop") == 1
    keys.create("laptop")
    assert [k.revoked is None for k in keys.list()] == [False, True]


def test_quotas_count_what_jobs_used(database: Database) -> None:
    keys = KeyStore(database)
    _, free = keys.create("free")
    _, bot = keys.create("bot", quota_seconds=10.0)
    keys.charge(bot.id, 6.5)
    keys.charge(free.id, 1e6)
    found = keys.get(bot.id)
    assert found is not None
    assert (found.used_seconds, found.exhausted) == (6.5, False)
    keys.charge(bot.id, 3.5)
    assert keys.get(bot.id).exhausted  # type: ignore[union-attr]
    assert not keys.get(free.id).exhausted  # type: ignore[union-attr]
    assert keys.set_quota("bot", 20.0) == 1
    assert not keys.get(bot.id).exhausted  # type: ignore[union-attr]
    assert keys.set_quota("bot", None) == 1
    assert keys.get(bot.id).quota_seconds is None  # type: ignore[union-attr]
    assert keys.set_quota("nobody", 1.0) == 0
    assert keys.get("nobody") is None
