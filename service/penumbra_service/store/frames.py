"""Frames of jobs that have several. A frame has a row once it was begun."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import insert, select, update

from penumbra_service.store.database import Database
from penumbra_service.store.schema import frames


class NoSuchFrameError(LookupError):
    """The job has no frame of this number."""


@dataclass(frozen=True)
class FrameRow:
    """A frame that was begun."""

    job: str
    number: int
    state: str
    progress: Mapping[str, Any]
    reason: str | None
    started: datetime
    finished: datetime | None


class FrameStore:
    """All methods are safe to call from several threads and processes."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def put(self, job: str, number: int, state: str, news: Mapping[str, Any], **fields: Any) -> None:
        """Write down how a frame stands; `news` are added to its progress. `fields`: reason, finished."""
        here = (frames.c.job == job) & (frames.c.number == number)
        with self._database.write() as connection:
            known = connection.execute(select(frames.c.progress).where(here)).scalar_one_or_none()
            values = {"state": state, "progress": {**(known or {}), **news}, **fields}
            if known is None:
                values |= {"job": job, "number": number, "started": datetime.now(UTC)}
                connection.execute(insert(frames).values(**values))
            else:
                connection.execute(update(frames).where(here).values(**values))

    def note_picture(self, job: str, number: int) -> None:
        """There is a new picture of a frame that was begun."""
        here = (frames.c.job == job) & (frames.c.number == number)
        with self._database.write() as connection:
            known = connection.execute(select(frames.c.progress).where(here)).scalar_one_or_none()
            if known is not None:
                revision = known.get("thumbnail_revision", 0) + 1
                progress = {**known, "thumbnail_revision": revision}
                connection.execute(update(frames).where(here).values(progress=progress))

    def of_job(self, job: str, after: int = -1, before: int | None = None) -> list[FrameRow]:
        """Frames that were begun, by number, with numbers above `after` and below `before`."""
        query = select(frames).where(frames.c.job == job, frames.c.number > after)
        if before is not None:
            query = query.where(frames.c.number < before)
        with self._database.read() as connection:
            rows = connection.execute(query.order_by(frames.c.number))
            return [FrameRow(**row._mapping) for row in rows]
