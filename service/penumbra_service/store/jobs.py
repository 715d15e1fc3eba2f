"""The ledger of jobs. It keeps documents and order; it does not know what a state means.

Every change of a job raises its `revision`, by which watchers know what they have not seen yet.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Final, NamedTuple, Protocol

from sqlalchemy import Connection, DateTime, Select, delete, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from penumbra_service.store.database import Database
from penumbra_service.store.ids import is_id, new_id
from penumbra_service.store.schema import frames, jobs, requests

MAX_PAGE: Final = 1000


class IdempotencyConflictError(Exception):
    """The key was used before, with another body; `job_id` is what it made then."""

    def __init__(self, job_id: str) -> None:
        super().__init__(f"the idempotency key already made job {job_id} from another body")
        self.job_id = job_id


class NoSuchJobError(LookupError):
    """No job has this identifier."""


@dataclass(frozen=True)
class NewJob:
    """What a submission brings. `scope` separates the idempotency keys of different callers."""

    request: str
    body_digest: str
    name: str
    priority: int = 0
    owner: str | None = None
    idempotency_key: str | None = None
    state: str = "queued"
    progress: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scope(self) -> str | None:
        return None if self.idempotency_key is None else (self.owner or "")


class JobRow(NamedTuple):
    """A job without its request, which may be many megabytes. A tuple: a list makes a thousand of them."""

    id: str
    state: str
    priority: int
    name: str
    progress: Mapping[str, Any]
    revision: int
    crashes: int
    reason: str | None
    owner: str | None
    created: datetime
    updated: datetime
    started: datetime | None
    finished: datetime | None
    holder: str | None = None
    """The service that renders it."""
    heartbeat: datetime | None = None
    """When the holder was last known to live."""


class JobStore(Protocol):
    """What the service asks of a ledger. All methods are safe to call from several threads and processes."""

    def create(self, job: NewJob, check: Callable[[NewJob], None] = lambda job: None) -> tuple[JobRow, bool]:
        """The job and whether it is new; `check` may refuse new ones by raising. Raises IdempotencyConflictError."""

    def get(self, job_id: str) -> JobRow:
        """Raises NoSuchJobError."""

    def request(self, job_id: str) -> str:
        """The request's JSON text. Raises NoSuchJobError."""

    def page(self, states: Collection[str] = (), before: str | None = None, limit: int = 50) -> list[JobRow]:
        """The newest jobs first, older than `before`, in any of the states (all where none is given)."""

    def waiting(self, states: Collection[str], limit: int | None = None) -> list[JobRow]:
        """Jobs in these states in the order of the queue, or the first `limit` of them: higher priority first, then
        the older."""

    def move(
        self, job_id: str, allowed: Collection[str], to: str, *, holder: str | None = None, **fields: Any
    ) -> JobRow | None:
        """Changes the state if it is one of `allowed` and, where it is given, `holder` holds the job; else None.
        `fields` are further columns to set."""

    def claim(self, waiting: Collection[str], to: str, holder: str) -> JobRow | None:
        """The first job of the queue, moved and held: of many who ask, in any process, one gets it."""

    def beat(self, holder: str, states: Collection[str]) -> int:
        """The holder lives: tells so for all jobs that it has in these states, and how many those are."""

    def release(self, states: Collection[str], to: str, silent_seconds: float | None) -> list[JobRow]:
        """Takes jobs in these states from their holders: from those that were silent for so long by the
        ledger's clock, or from all."""

    def count(self, states: Collection[str]) -> int:
        """How many jobs are in these states."""

    def ended_before(self, states: Collection[str], moment: datetime, limit: int = 100) -> list[JobRow]:
        """Jobs in these states that finished before a moment, the oldest first."""

    def remove(self, job_id: str) -> None:
        """Forgets a job with its frames."""

    def names_asset(self, sha256: str) -> bool:
        """Whether any job's request names an asset."""

    def set(self, job_id: str, **fields: Any) -> JobRow:
        """Sets columns: progress, priority, crashes, reason, started, finished. Raises NoSuchJobError."""

    def counts(self) -> dict[str, int]:
        """How many jobs each state has."""


_COLUMNS: Final = [jobs.c[name] for name in JobRow._fields]
_SETTABLE: Final = frozenset({"progress", "priority", "crashes", "reason", "started", "finished"})


class SqlJobStore:
    """JobStore in an SQL database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create(self, job: NewJob, check: Callable[[NewJob], None] = lambda job: None) -> tuple[JobRow, bool]:
        earlier = self._earlier(job)
        if earlier is not None:
            return earlier, False
        check(job)
        try:
            return self._insert(job), True
        except IntegrityError:  # the same submission came twice at once
            earlier = self._earlier(job)
            if earlier is None:
                raise
            return earlier, False

    def _earlier(self, job: NewJob) -> JobRow | None:
        """The job that the idempotency key has made before. Raises IdempotencyConflictError."""
        if job.idempotency_key is None:
            return None
        with self._database.read() as connection:
            earlier = connection.execute(_by_idempotency(job)).one_or_none()
            if earlier is None:
                return None
            if earlier.body_digest != job.body_digest:
                raise IdempotencyConflictError(earlier.id)
            return _job(connection.execute(_by_id(earlier.id)).one())

    def _insert(self, job: NewJob) -> JobRow:
        with self._database.write() as connection:
            now = datetime.now(UTC)
            row_id = new_id()
            connection.execute(insert(jobs).values(**_values(job), id=row_id, created=now, updated=now))
            connection.execute(insert(requests).values(job=row_id, text=job.request))
            return _job(connection.execute(_by_id(row_id)).one())

    def get(self, job_id: str) -> JobRow:
        _demand_id(job_id)
        with self._database.read() as connection:
            row = connection.execute(_by_id(job_id)).one_or_none()
        if row is None:
            raise NoSuchJobError(job_id)
        return _job(row)

    def request(self, job_id: str) -> str:
        _demand_id(job_id)
        with self._database.read() as connection:
            text = connection.execute(
                select(requests.c.text).where(requests.c.job == job_id)
            ).scalar_one_or_none()
        if text is None:
            raise NoSuchJobError(job_id)
        return str(text)

    def page(self, states: Collection[str] = (), before: str | None = None, limit: int = 50) -> list[JobRow]:
        query = select(*_COLUMNS).order_by(jobs.c.id.desc()).limit(min(limit, MAX_PAGE))
        if states:
            query = query.where(jobs.c.state.in_(states))
        if before is not None:
            query = query.where(jobs.c.id < before)
        with self._database.read() as connection:
            return [_job(row) for row in connection.execute(query)]

    def waiting(self, states: Collection[str], limit: int | None = None) -> list[JobRow]:
        query = select(*_COLUMNS).where(jobs.c.state.in_(states)).order_by(jobs.c.priority.desc(), jobs.c.id)
        query = query.limit(limit)
        with self._database.read() as connection:
            return [_job(row) for row in connection.execute(query)]

    def move(
        self, job_id: str, allowed: Collection[str], to: str, *, holder: str | None = None, **fields: Any
    ) -> JobRow | None:
        change = update(jobs).where(jobs.c.id == job_id, jobs.c.state.in_(allowed))
        if holder is not None:
            change = change.where(jobs.c.holder == holder)
        return self._change(job_id, change.values(state=to, **_changes(fields)))

    def claim(self, waiting: Collection[str], to: str, holder: str) -> JobRow | None:
        # Several services: PostgreSQL passes over rows that others are claiming, SQLite has one writer at a time.
        first = (
            select(jobs.c.id, jobs.c.started)
            .where(jobs.c.state.in_(waiting))
            .order_by(jobs.c.priority.desc(), jobs.c.id)
            .limit(1)
            .with_for_update(skip_locked=True)
        )
        with self._database.write() as connection:
            found = connection.execute(first).one_or_none()
            if found is None:
                return None
            now = datetime.now(UTC)
            held = {"holder": holder, "heartbeat": _clock(connection), "started": found.started or now}
            change = update(jobs).where(jobs.c.id == found.id)
            connection.execute(change.values(state=to, **held, **_changes({})))
            return _job(connection.execute(_by_id(found.id)).one())

    def beat(self, holder: str, states: Collection[str]) -> int:
        held = (jobs.c.holder == holder) & jobs.c.state.in_(states)
        with self._database.write() as connection:
            return connection.execute(update(jobs).where(held).values(heartbeat=_clock(connection))).rowcount

    def release(self, states: Collection[str], to: str, silent_seconds: float | None) -> list[JobRow]:
        orphans = select(jobs.c.id).where(jobs.c.state.in_(states))
        released = []
        with self._database.write() as connection:
            if silent_seconds is not None:
                since = _clock(connection) - timedelta(seconds=silent_seconds)
                orphans = orphans.where((jobs.c.heartbeat < since) | jobs.c.heartbeat.is_(None))
            for row in connection.execute(orphans.with_for_update(skip_locked=True)).all():
                change = update(jobs).where(jobs.c.id == row.id)
                connection.execute(change.values(state=to, holder=None, **_changes({})))
                released.append(_job(connection.execute(_by_id(row.id)).one()))
        return released

    def count(self, states: Collection[str]) -> int:
        query = select(func.count()).select_from(jobs).where(jobs.c.state.in_(states))
        with self._database.read() as connection:
            return int(connection.execute(query).scalar_one())

    def ended_before(self, states: Collection[str], moment: datetime, limit: int = 100) -> list[JobRow]:
        old = select(*_COLUMNS).where(jobs.c.state.in_(states), jobs.c.finished < moment)
        with self._database.read() as connection:
            return [_job(row) for row in connection.execute(old.order_by(jobs.c.finished).limit(limit))]

    def remove(self, job_id: str) -> None:
        with self._database.write() as connection:
            connection.execute(delete(frames).where(frames.c.job == job_id))
            connection.execute(delete(requests).where(requests.c.job == job_id))
            connection.execute(delete(jobs).where(jobs.c.id == job_id))

    def names_asset(self, sha256: str) -> bool:
        query = select(requests.c.job).where(requests.c.text.contains(sha256)).limit(1)
        with self._database.read() as connection:
            return connection.execute(query).first() is not None

    def set(self, job_id: str, **fields: Any) -> JobRow:
        row = self._change(job_id, update(jobs).where(jobs.c.id == job_id).values(**_changes(fields)))
        if row is None:
            raise NoSuchJobError(job_id)
        return row

    def counts(self) -> dict[str, int]:
        query = select(jobs.c.state, func.count().label("count_")).group_by(jobs.c.state)
        with self._database.read() as connection:
            return {row.state: row.count_ for row in connection.execute(query)}

    def _change(self, job_id: str, change: Any) -> JobRow | None:
        if not is_id(job_id):
            return None
        with self._database.write() as connection:
            if connection.execute(change).rowcount == 0:
                return None
            return _job(connection.execute(_by_id(job_id)).one())


def _demand_id(job_id: str) -> None:
    """What is no identifier never reaches the database: PostgreSQL takes no text with a NUL."""
    if not is_id(job_id):
        raise NoSuchJobError(job_id)


def _clock(connection: Connection) -> Any:
    """Now, as all who share the ledger see it."""
    if connection.dialect.name == "sqlite":  # they are on one machine
        return datetime.now(UTC)
    return func.clock_timestamp(type_=DateTime(timezone=True))


def _by_id(job_id: str) -> Select[Any]:
    return select(*_COLUMNS).where(jobs.c.id == job_id)


def _by_idempotency(job: NewJob) -> Select[Any]:
    return select(jobs.c.id, jobs.c.body_digest).where(
        jobs.c.idempotency_scope == job.scope, jobs.c.idempotency_key == job.idempotency_key
    )


def _values(job: NewJob) -> dict[str, Any]:
    return {
        "state": job.state,
        "priority": job.priority,
        "name": job.name,
        "progress": dict(job.progress),
        "revision": 1,
        "crashes": 0,
        "owner": job.owner,
        "idempotency_scope": job.scope,
        "idempotency_key": job.idempotency_key,
        "body_digest": job.body_digest,
    }


def _changes(fields: Mapping[str, Any]) -> dict[str, Any]:
    unknown = fields.keys() - _SETTABLE
    if unknown:
        raise ValueError(f"cannot set {sorted(unknown)}; what can be set: {sorted(_SETTABLE)}")
    return {**fields, "revision": jobs.c.revision + 1, "updated": datetime.now(UTC)}


def _job(row: Any) -> JobRow:
    return JobRow._make(row)
