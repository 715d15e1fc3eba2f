"""Rows of frames."""

from __future__ import annotations

from datetime import UTC, datetime

from penumbra_service.store.database import Database
from penumbra_service.store.frames import FrameStore
from penumbra_service.store.jobs import NewJob, SqlJobStore


def test_frames_keep_their_first_start_and_add_news(database: Database) -> None:
    jobs, frames = SqlJobStore(database), FrameStore(database)
    job = jobs.create(NewJob("{}", "d" * 64, "a"))[0].id
    other = jobs.create(NewJob("{}", "d" * 64, "b"))[0].id
    assert frames.of_job(job) == []
    frames.put(job, 7, "rendering", {"progress": 0.5, "seconds": 1.0})
    frames.put(job, 3, "compiling", {})
    frames.put(other, 7, "done", {})
    started = {row.number: row.started for row in frames.of_job(job)}
    now = datetime.now(UTC)
    frames.put(job, 7, "done", {"progress": 1.0}, reason="samples", finished=now)
    rows = frames.of_job(job)
    assert [(row.number, row.state) for row in rows] == [(3, "compiling"), (7, "done")]
    assert rows[1].progress == {"progress": 1.0, "seconds": 1.0}
    assert rows[1].finished == now
    assert {row.number: row.started for row in rows} == started
    assert [row.number for row in frames.of_job(job, after=3)] == [7]
    assert [row.number for row in frames.of_job(job, before=7)] == [3]


def test_every_new_picture_raises_a_frames_revision(database: Database) -> None:
    jobs, frames = SqlJobStore(database), FrameStore(database)
    job = jobs.create(NewJob("{}", "d" * 64, "a"))[0].id
    frames.note_picture(job, 1)  # it has not reported yet
    assert frames.of_job(job) == []
    frames.put(job, 1, "rendering", {"progress": 0.1})
    frames.note_picture(job, 1)
    frames.put(job, 1, "rendering", {"progress": 0.2})
    frames.note_picture(job, 1)
    assert frames.of_job(job)[0].progress == {"progress": 0.2, "thumbnail_revision": 2}
