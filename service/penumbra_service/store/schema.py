"""The tables of the job store. Times are UTC; JSON documents are kept whole, as the API speaks them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Final

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    DateTime,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)
from sqlalchemy.engine import Dialect
from sqlalchemy.types import TypeDecorator

ID_LENGTH: Final = 26
"""Characters of a job's identifier, see ids.py."""
DIGEST_LENGTH: Final = 64
"""Hexadecimal digits of a SHA-256."""


class UtcTime(TypeDecorator[datetime]):
    """A moment in UTC; SQLite keeps no zone, so it is put back on reading."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: Any, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        time: datetime = value
        return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


metadata = MetaData()

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", String(ID_LENGTH), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("digest", LargeBinary(32), nullable=False, unique=True),
    Column("hint", String(16), nullable=False),
    Column("created", UtcTime(), nullable=False),
    Column("revoked", UtcTime()),
    Column("quota_seconds", Float),
    Column("used_seconds", Float, nullable=False, server_default="0"),
)

jobs = Table(
    "jobs",
    metadata,
    Column("id", String(ID_LENGTH), primary_key=True),
    Column("state", String(20), nullable=False),
    Column("priority", Integer, nullable=False),
    Column("name", String(200), nullable=False),
    Column("progress", JSON, nullable=False),
    Column("revision", Integer, nullable=False),
    Column("crashes", Integer, nullable=False),
    Column("reason", Text),
    Column("owner", String(ID_LENGTH), ForeignKey("api_keys.id")),
    Column("idempotency_scope", String(ID_LENGTH)),
    Column("idempotency_key", String(255)),
    Column("body_digest", String(DIGEST_LENGTH), nullable=False),
    Column("created", UtcTime(), nullable=False),
    Column("updated", UtcTime(), nullable=False),
    Column("started", UtcTime()),
    Column("finished", UtcTime()),
    Column("holder", String(ID_LENGTH)),
    Column("heartbeat", UtcTime()),
    UniqueConstraint("idempotency_scope", "idempotency_key", name="one_job_per_idempotency_key"),
    Index("jobs_by_queue_order", "state", "priority", "id"),
    Index("jobs_by_state", "state", "id"),
    Index("jobs_by_end", "finished"),
)

requests = Table(
    "requests",
    metadata,
    Column("job", String(ID_LENGTH), ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("text", Text, nullable=False),
)
"""What jobs ask for. It may have megabytes, through which SQLite would have to read for each row of a list."""

frames = Table(
    "frames",
    metadata,
    Column("job", String(ID_LENGTH), ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("state", String(20), nullable=False),
    Column("progress", JSON, nullable=False),
    Column("reason", Text),
    Column("started", UtcTime(), nullable=False),
    Column("finished", UtcTime()),
)

assets = Table(
    "assets",
    metadata,
    Column("sha256", String(DIGEST_LENGTH), primary_key=True),
    Column("bytes", BigInteger, nullable=False),
    Column("kind", String(20), nullable=False),
    Column("format", String(20), nullable=False),
    Column("detail", String(200), nullable=False),
    Column("owner", String(ID_LENGTH), ForeignKey("api_keys.id")),
    Column("created", UtcTime(), nullable=False),
)
