"""The scheduler dies, contents cannot be had, the disk is full; the picture has the bits of the undisturbed one."""

from __future__ import annotations

import errno
import threading
from dataclasses import replace

import pytest
from penumbra_scene.job import JobRequest, JobState
from penumbra_service.engine.runner import Halt, JobRunner
from penumbra_service.film.tilefile import FolderTileStore
from penumbra_service.quoting import make_quote
from penumbra_service.store.contents import ContentStore


def test_a_killed_scheduler_costs_the_leases_in_flight(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    farm.wait_for("one", "two")

    def disturb() -> None:
        farm.kill("scheduler")
        farm.start_scheduler()

    result = farm.run(make_task(), disturb)
    assert picture(result) == undisturbed
    assert 1 <= result.record.redone_leases <= 4
    assert result.record.crashes == 0


def test_a_cut_connection_to_a_worker_is_made_again(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    farm.wait_for("one", "two")
    cut = []

    def disturb() -> None:
        for device in list(farm.engine._devices.values()):
            cut.append(device.description.id)
            farm.engine._loop.call_soon_threadsafe(device.channel.abort)

    result = farm.run(make_task(), disturb)
    assert picture(result) == undisturbed
    assert sorted(cut) == ["fake:0@one", "fake:0@two"]
    assert 1 <= result.record.redone_leases <= 4
    assert result.record.crashes == 0


def test_a_quote_of_a_farm_is_that_of_its_workers(farm, make_task, tmp_path, monkeypatch):  # type: ignore[no-untyped-def]
    """The pilot's blocks go to all of them; what it foretells is what a job on them takes."""
    monkeypatch.setattr("penumbra_service.engine.pilot.PILOT_SECONDS", 1e4)  # however busy the machine is
    farm.wait_for("one", "two")
    task = make_task("steady", stop={"relative_error": 0.04})
    quote = make_quote(farm.engine, JobRequest(scene=task.scene), tmp_path / "quote", tmp_path / "assets")
    assert {device.id for device in quote.devices} == {"fake:0@one", "fake:0@two"}
    result = farm.run(task)
    real = result.record.points[-1].samples
    assert quote.end.reason == "relative_error"
    assert real / 1.5 < quote.end.samples < 1.5 * real
    assert quote.end.samples_interval.low <= real <= quote.end.samples_interval.high
    assert quote.seconds_per_sample > 0


def test_a_store_that_cannot_be_written_fails_the_job_with_words(farm, make_task, monkeypatch):  # type: ignore[no-untyped-def]
    def put(*_: object) -> None:
        raise OSError(errno.EACCES, "Permission denied")

    farm.wait_for("one", "two")
    monkeypatch.setattr(ContentStore, "put", put)
    failure = JobRunner(farm.engine, make_task("steady other")).run().failure
    assert failure is not None
    assert failure.kind == "storage"
    assert "the scene cannot be published: [Errno 13] Permission denied" in failure.message


def test_a_store_that_is_full_is_waited_for(farm, make_task, picture, undisturbed, monkeypatch):  # type: ignore[no-untyped-def]
    put, refused = ContentStore.put, []

    def put_later(*words: object) -> None:
        if len(refused) < 2:
            refused.append(words)
            raise OSError(errno.ENOSPC, "No space left on device")
        put(*words)  # type: ignore[arg-type]

    farm.wait_for("one", "two")
    monkeypatch.setattr(ContentStore, "put", put_later)
    monkeypatch.setattr("penumbra_service.engine.dask.publisher.SPACE_SECONDS", 0.2)
    assert picture(farm.run(make_task("steady yet another"))) == undisturbed
    assert len(refused) == 2


@pytest.fixture
def full_disk(monkeypatch):  # type: ignore[no-untyped-def]
    """full_disk.set(): writes of snapshots fail from now on, as long as it is set."""
    full = threading.Event()
    write = FolderTileStore.write

    def limited(self: FolderTileStore, name: str, data: bytes) -> None:
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, name, data)

    monkeypatch.setattr(FolderTileStore, "write", limited)
    monkeypatch.setattr("penumbra_service.engine.runner.SPACE_SECONDS", 0.5)
    monkeypatch.setattr("penumbra_service.engine.course.SNAPSHOT_SECONDS", 0.5)
    monkeypatch.setattr(
        "penumbra_service.engine.course.SNAPSHOT_SHARE", 0.0
    )  # however long the last one took
    return full


def test_a_full_disk_is_waited_for(farm, make_task, picture, undisturbed, full_disk):  # type: ignore[no-untyped-def]
    farm.wait_for("one", "two")

    def disturb() -> None:
        full_disk.set()
        threading.Timer(2.0, full_disk.clear).start()

    result = farm.run(replace(make_task(), wait_for_room=True), disturb)
    assert picture(result) == undisturbed
    assert result.record.resumed >= 1
    assert "the disk was full" in " ".join(result.record.warnings)


@pytest.mark.parametrize(
    ("halt", "state"), [(Halt.PAUSE, JobState.PAUSED), (Halt.CANCEL, JobState.CANCELLED)]
)
def test_a_job_that_waits_for_room_can_be_stopped(farm, make_task, full_disk, halt, state):  # type: ignore[no-untyped-def]
    runner = JobRunner(farm.engine, replace(make_task("steady"), wait_for_room=True))
    full_disk.set()
    threading.Timer(1.0, runner.halt, (halt,)).start()
    assert runner.run().state is state
