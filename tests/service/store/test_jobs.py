"""The ledger of jobs: one body of tests that every JobStore passes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import pytest
from penumbra_service.store.database import Database
from penumbra_service.store.frames import FrameStore
from penumbra_service.store.jobs import (
    IdempotencyConflictError,
    JobStore,
    NewJob,
    NoSuchJobError,
    SqlJobStore,
)
from penumbra_service.store.schema import jobs
from sqlalchemy import update

MAKERS: dict[str, Callable[[Database], JobStore]] = {"sql": SqlJobStore}


@pytest.fixture(params=MAKERS)
def store(request: pytest.FixtureRequest, database: Database) -> JobStore:
    return MAKERS[request.param](database)


def job(**changes: object) -> NewJob:
    fields = {"request": '{"scene": {}}', "body_digest": "d" * 64, "name": "a job", **changes}
    return NewJob(**fields)  # type: ignore[arg-type]


def test_what_goes_in_comes_out(store: JobStore) -> None:
    before = datetime.now(UTC)
    made, new = store.create(job(priority=-3, progress={"width": 5, "deep": {"list": [1.5, None]}}))
    assert new
    assert store.get(made.id) == made
    assert (made.state, made.priority, made.name, made.revision, made.crashes) == (
        "queued",
        -3,
        "a job",
        1,
        0,
    )
    assert made.progress == {"width": 5, "deep": {"list": [1.5, None]}}
    assert store.request(made.id) == '{"scene": {}}'
    assert before <= made.created <= datetime.now(UTC)
    assert made.created.tzinfo is not None
    assert made.started is None


@pytest.mark.parametrize(
    "unknown", ["01ARZ3NDEKTSV4RRFFQ69G5FAV", "", "x", "a\0b", "01ARZ3NDEKTSV4RRFFQ69G5FAV\0", "é" * 5000]
)
def test_unknown_jobs_are_told(store: JobStore, unknown: str) -> None:
    for call in (store.get, store.request, store.set):
        with pytest.raises(NoSuchJobError):
            call(unknown)
    assert store.move(unknown, ("queued",), "done") is None


def test_every_change_raises_the_revision(store: JobStore) -> None:
    made, _ = store.create(job())
    changed = store.set(made.id, progress={"progress": 0.5}, crashes=1)
    assert changed.revision == 2
    assert changed.progress == {"progress": 0.5}
    assert changed.updated >= made.updated
    moved = store.move(made.id, ("queued",), "compiling", started=made.created)
    assert moved is not None
    assert (moved.revision, moved.started) == (3, made.created)
    assert store.move(made.id, ("queued",), "rendering") is None
    assert store.get(made.id) == moved
    with pytest.raises(ValueError, match="state"):
        store.set(made.id, state="done")


def test_the_queue_is_by_priority_then_age(store: JobStore) -> None:
    ids = [store.create(job(priority=p))[0].id for p in (0, 5, 0, -1, 5)]
    store.move(store.create(job(priority=9))[0].id, ("queued",), "done")
    assert [row.id for row in store.waiting(("queued",))] == [ids[i] for i in (1, 4, 0, 2, 3)]


def test_pages_go_back_in_time_without_gaps(store: JobStore) -> None:
    ids = [store.create(job())[0].id for _ in range(7)]
    assert ids == sorted(ids)
    found: list[str] = []
    before = None
    while page := store.page(before=before, limit=3):
        found += [row.id for row in page]
        before = page[-1].id
        store.create(job())  # a newer one, which must not show up
    assert found == ids[::-1]


def test_pages_filter_and_counts_count(store: JobStore) -> None:
    ids = [store.create(job())[0].id for _ in range(4)]
    store.move(ids[1], ("queued",), "done")
    store.move(ids[2], ("queued",), "failed", reason="failed")
    assert [row.id for row in store.page(("done", "failed"))] == [ids[2], ids[1]]
    assert store.counts() == {"queued": 2, "done": 1, "failed": 1}


def test_one_key_makes_one_job(store: JobStore) -> None:
    first, new = store.create(job(idempotency_key="k"))
    again, repeated = store.create(job(idempotency_key="k"))
    assert new
    assert not repeated
    assert again == first
    with pytest.raises(IdempotencyConflictError) as caught:
        store.create(job(idempotency_key="k", body_digest="e" * 64))
    assert caught.value.job_id == first.id
    assert store.create(job(idempotency_key="other"))[1]
    assert store.create(job())[1]
    assert store.create(job())[1]


def test_keys_meet_in_threads_and_still_make_one_job(store: JobStore) -> None:
    made = []

    def submit() -> None:
        made.append(store.create(job(idempotency_key="k")))

    threads = [threading.Thread(target=submit) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({row.id for row, _ in made}) == 1
    assert sum(new for _, new in made) == 1


def test_of_many_who_take_a_job_one_gets_it(store: JobStore) -> None:
    made, _ = store.create(job())
    taken = []

    def take() -> None:
        taken.append(store.move(made.id, ("queued",), "compiling"))

    threads = [threading.Thread(target=take) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(row is not None for row in taken) == 1


def test_of_many_who_claim_each_gets_jobs_of_its_own_in_the_order_of_the_queue(store: JobStore) -> None:
    low = [store.create(job())[0].id for _ in range(12)]
    high = store.create(job(priority=5))[0].id
    first = store.claim(("queued",), "compiling", "me")
    assert first is not None
    assert (first.id, first.state, first.holder) == (high, "compiling", "me")
    assert first.heartbeat is not None
    assert first.started is not None
    taken: list[str] = []

    def claim(name: str) -> None:
        while (row := store.claim(("queued",), "compiling", name)) is not None:
            taken.append(row.id)
            assert row.holder == name

    threads = [threading.Thread(target=claim, args=(f"service {n}",)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(taken) == sorted(low)


def test_only_silent_holders_lose_their_jobs(store: JobStore, database: Database) -> None:
    for name in ("dead", "alive"):
        store.create(job(name=name))
    rows = [store.claim(("queued",), "compiling", f"{n}") for n in range(2)]
    dead, alive = (next(r for r in rows if r and r.name == name) for name in ("dead", "alive"))
    long_ago = datetime.now(UTC) - timedelta(hours=1)
    with database.write() as connection:
        connection.execute(update(jobs).values(heartbeat=long_ago))
    assert alive.holder is not None
    assert store.beat(alive.holder, ("compiling",)) == 1
    assert store.beat("nobody", ("compiling",)) == 0
    assert [row.id for row in store.release(("compiling",), "queued", 600.0)] == [dead.id]
    assert store.get(dead.id).holder is None
    assert store.get(alive.id).state == "compiling"
    # who lost its job cannot move it any more, who holds one can
    assert store.move(dead.id, ("queued",), "done", holder=dead.holder) is None
    assert store.move(alive.id, ("compiling",), "done", holder=alive.holder) is not None
    assert store.release(("done",), "queued", None) != []


def test_a_refused_job_leaves_nothing_and_a_repeated_one_is_not_asked_about(store: JobStore) -> None:
    def refuse(_: NewJob) -> None:
        raise ValueError("full")

    with pytest.raises(ValueError, match="full"):
        store.create(job(idempotency_key="k"), refuse)
    assert store.page() == []
    made, _ = store.create(job(idempotency_key="k"))
    assert store.create(job(idempotency_key="k"), refuse) == (made, False)


def test_old_jobs_are_found_and_removed_with_their_frames(store: JobStore, database: Database) -> None:
    frames = FrameStore(database)
    now = datetime.now(UTC)
    ids = [store.create(job(request=f'{{"asset": "sha256:{n}"}}'))[0].id for n in range(3)]
    for n, job_id in enumerate(ids):
        store.move(job_id, ("queued",), "done", finished=now - timedelta(days=n))
        frames.put(job_id, 1, "done", {})
    store.create(job())
    assert [row.id for row in store.ended_before(("done",), now - timedelta(hours=1))] == [ids[2], ids[1]]
    assert store.names_asset("sha256:1")
    store.remove(ids[1])
    assert not store.names_asset("sha256:1")
    assert frames.of_job(ids[1]) == []
    assert frames.of_job(ids[2]) != []
    assert store.counts() == {"done": 2, "queued": 1}
    assert store.count(("done", "queued")) == 3
