"""Whole jobs on fake devices: same bits whatever happens on the way, and every way to end."""

from __future__ import annotations

import importlib.util
import math
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile
from penumbra_scene.job import JobState, StopReason
from penumbra_service.engine.canvas import Canvas
from penumbra_service.engine.runner import Halt, JobRunner
from penumbra_service.film.replicates import DEFAULT_REPLICATES as R
from penumbra_service.jobs.planning import WorkItem

_spec = importlib.util.spec_from_file_location("engine_conftest", Path(__file__).with_name("conftest.py"))
assert _spec is not None
assert _spec.loader is not None
_helpers = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_helpers)
picture = _helpers.picture
_reference: list[bytes] = []


@pytest.fixture
def reference(fake_engine, make_task):  # type: ignore[no-untyped-def]
    """The undisturbed picture of 32 samples."""
    if not _reference:
        result = JobRunner(fake_engine(), make_task(folder="reference")).run()
        assert result.state is JobState.FINISHING
        assert result.reason is StopReason.SAMPLES
        _reference.append(picture(result))
    return _reference[0]


def test_a_job_gives_the_mean_of_its_samples(fake_engine, make_task):  # type: ignore[no-untyped-def]
    task = make_task(stop={"samples": 64}, sampler={"type": "independent", "seed": 5})
    seen = []
    result = JobRunner(
        fake_engine(), task, on_progress=lambda state, progress: seen.append((state, progress))
    ).run()
    bands = list(result.bands())
    red = np.concatenate([b.floats["R"] for b in bands])
    variance = np.concatenate([b.floats["Variance.R"] for b in bands])
    assert red.shape == (72, 80)
    n = red.size
    assert abs(red.mean() - 0.5) < 4.9 * math.sqrt(1 / 12 / 64 / n)
    true = 1 / 12 / 64
    assert abs(variance.mean() - true) < 4.9 * true * math.sqrt(2 / (R - 1) / n)
    assert (np.concatenate([b.integers["SampleCount"] for b in bands]) == 64).all()
    assert result.end == 64 // R
    shares = [progress.progress for _, progress in seen]
    assert shares == sorted(shares)
    assert {state for state, _ in seen} >= {JobState.RENDERING, JobState.FINISHING}
    assert seen[-1][1].samples_done == 64
    assert result.record.counts.taken == 64 * n
    assert result.record.bit_class == "fake|1.0"


def test_bits_do_not_depend_on_devices_or_tiles(fake_engine, make_task, reference, monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 32)
    engine = fake_engine("fake:0,fake:1,fake:2")
    assert picture(JobRunner(engine, make_task()).run()) == reference


def test_the_first_tiles_are_shown_at_once(fake_engine, make_task, monkeypatch):  # type: ignore[no-untyped-def]
    """Before the first look at the whole picture, however seldom progress is told."""
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    monkeypatch.setattr("penumbra_service.engine.reporter.PROGRESS_SECONDS", 1e9)
    monkeypatch.setattr("penumbra_service.jobs.planning.MAX_LEASE_ITEMS", 4)
    told: list[str] = []
    JobRunner(
        fake_engine(),
        make_task(name="slow plain", stop={"samples": 16}),
        on_progress=lambda _, progress: told.append("progress" if progress.relmse is None else "error"),
        on_preview=lambda image: told.append("preview"),
    ).run()
    assert told.index("preview") < told.index("error")


def test_a_killed_process_costs_time_and_nothing_else(fake_engine, make_task, reference, monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    engine = fake_engine()
    task = make_task(name="slow plain")
    runner = JobRunner(engine, task)
    results = []
    thread = threading.Thread(target=lambda: results.append(runner.run()))
    thread.start()
    _wait_for(lambda: engine.devices())
    slot, before = engine._slots[0], engine.devices()[0].crashes
    for kill in (1, 2):
        _wait_for(lambda: slot.running is not None)
        os.kill(slot.process.pid, signal.SIGKILL)
        _wait_for(lambda n=before + kill: slot.crashes == n)
    thread.join(60)
    (result,) = results
    assert result.state is JobState.FINISHING
    assert result.record.crashes == 2
    assert result.record.redone_leases >= 2
    # the name is no part of what is sampled
    assert picture(result) == reference
    assert engine.devices()[0].crashes == before + 2


def test_work_that_waits_twice_does_not_end_a_job_before_its_rule(
    fake_engine, make_task, reference, monkeypatch
):  # type: ignore[no-untyped-def]
    """As after a device that gave wrong sums: its tiles are planned anew beside the work that was under way."""
    for name in ("MIN_BATCH_SECONDS", "LOOK_FACTOR"):  # speed merges no batches
        monkeypatch.setattr(f"penumbra_service.jobs.batches.{name}", 0.0)
    runner = JobRunner(fake_engine(), make_task(name="slow plain"))
    check, ends = Canvas.check, []

    def check_and_plan_again(canvas, seconds, confidence):  # type: ignore[no-untyped-def]
        if not ends:
            runner._desk.add([WorkItem(tile, 0, 1) for tile in canvas.film.tiles] * 10)
        ends.append(canvas.batches.current)
        return check(canvas, seconds, confidence)

    monkeypatch.setattr(Canvas, "check", check_and_plan_again)
    result = runner.run()
    assert result.reason is StopReason.SAMPLES
    assert ends == [1, 2, 4, 8]
    assert picture(result) == reference


def _wait_for(condition, seconds=20.0):  # type: ignore[no-untyped-def]
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("where", ["crash-load", "crash-trace"])
def test_three_crashes_fail_the_job_and_leave_the_engine_up(fake_engine, make_task, where, caplog):  # type: ignore[no-untyped-def]
    engine = fake_engine()
    result = JobRunner(engine, make_task(name=where)).run()
    assert result.state is JobState.FAILED
    assert result.failure.kind == "crash"
    assert "SIGABRT" in result.failure.message
    assert result.record.crashes == 3
    told = [
        r
        for r in caplog.records
        if r.getMessage().startswith("a lease is lost: the process of device fake:0")
    ]
    assert len(told) >= 3
    assert all((r.job, r.device) == ("job", "fake:0") and r.lease.startswith("job/") for r in told)
    if where == "crash-load":
        assert "the driver says goodbye" in result.failure.message
    after = JobRunner(engine, make_task(folder="after")).run()
    assert after.state is JobState.FINISHING


def test_a_crashing_job_does_not_harm_one_beside_it(fake_engine, make_task, reference):  # type: ignore[no-untyped-def]
    engine = fake_engine("fake:0,fake:1")
    results = {}

    def run(name, folder):  # type: ignore[no-untyped-def]
        results[folder] = JobRunner(engine, make_task(name=name, folder=folder)).run()

    threads = [threading.Thread(target=run, args=a) for a in (("crash-trace", "bad"), ("slow", "good"))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert results["bad"].state is JobState.FAILED
    assert picture(results["good"]) == reference
    assert results["good"].record.crashes == 0


def test_a_hung_device_is_killed_and_three_times_fail_the_job(fake_engine, make_task, monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.desk.UNKNOWN_DEADLINE", 0.3)
    result = JobRunner(fake_engine(), make_task(name="hang")).run()
    assert result.state is JobState.FAILED
    assert "did not answer in time" in result.failure.message


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("bad-scene", "scene", "upload it first"),
        ("bad-build", "build", "trace.cl:1: error"),
        ("bad-device", "crash", "out of resources"),
    ],
)
def test_what_another_attempt_would_not_mend_fails_with_its_reason(fake_engine, make_task, name, kind, words):  # type: ignore[no-untyped-def]
    result = JobRunner(fake_engine(), make_task(name=name)).run()
    assert result.state is JobState.FAILED
    assert result.failure.kind == kind
    assert words in result.failure.message


def test_no_device_fails_the_job(fake_engine, make_task):  # type: ignore[no-untyped-def]
    result = JobRunner(fake_engine(""), make_task()).run()
    assert result.failure.kind == "device"
    assert "no OpenCL device" in result.failure.message


def test_a_device_that_cannot_be_opened_is_left_out(fake_engine, make_task, reference, monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.slot.RETRY_SECONDS", (0.0,))
    engine = fake_engine("fake:0,fake:1", broken="fake:1")
    result = JobRunner(engine, make_task(name="slow")).run()
    assert picture(result) == reference
    assert [use.id for use in result.record.devices.values()] == ["fake:0"]


@pytest.mark.parametrize("lose", ["nothing", "tile", "progress"])
def test_a_paused_job_goes_on_with_the_same_bits(fake_engine, make_task, reference, monkeypatch, lose):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    engine = fake_engine()
    task = make_task(name="slow")
    done = []

    def pause_halfway(state, progress):  # type: ignore[no-untyped-def]
        done.append(progress.samples_done)
        if progress.samples_done > 10:
            first.halt(Halt.PAUSE)

    first = JobRunner(engine, task, on_progress=pause_halfway)
    paused = first.run()
    assert paused.state is JobState.PAUSED
    tiles = sorted((task.folder / "tiles").glob("*.tile"))
    assert tiles
    if lose == "tile":
        tiles[0].write_bytes(tiles[0].read_bytes()[:-100])
    if lose == "progress":
        (task.folder / "tiles" / "progress.json").write_text("{")
    begun, shown = [], []
    again = JobRunner(
        engine,
        task,
        on_progress=lambda state, progress: begun.append(progress.samples_done),
        on_preview=lambda image: shown.append(int((image.rgba[..., 3] > 0).sum())),
    )
    result = again.run()
    assert picture(result) == reference
    if lose == "nothing":
        assert begun[0] >= done[-1] > 10
        assert shown[0] == 80 * 72  # the whole picture, as it stood
    assert result.record.seconds > 0


def test_a_short_job_writes_no_state(fake_engine, make_task):  # type: ignore[no-untyped-def]
    """Its batches and looks would take longer to write down than to do again."""
    task = make_task(stop={"relative_error": 0.06})
    assert JobRunner(fake_engine(), task).run().reason is StopReason.RELATIVE_ERROR
    assert sorted(path.name for path in task.folder.rglob("*") if path.is_file()) == ["scene.json"]


def test_a_snapshot_of_another_scene_is_not_used(fake_engine, make_task, reference):  # type: ignore[no-untyped-def]
    engine = fake_engine()
    other = JobRunner(engine, make_task(sampler={"type": "independent", "seed": 9})).run()
    assert picture(other) != reference
    assert picture(JobRunner(engine, make_task()).run()) == reference


def test_cancel_ends_at_once(fake_engine, make_task):  # type: ignore[no-untyped-def]
    runner = JobRunner(fake_engine(), make_task(name="slow", stop={"samples": 1 << 20}))
    threading.Timer(0.5, lambda: runner.halt(Halt.CANCEL)).start()
    started = time.monotonic()
    result = runner.run()
    assert result.state is JobState.CANCELLED
    assert time.monotonic() - started < 5


def test_an_error_target_is_met_by_the_stated_margin(fake_engine, make_task):  # type: ignore[no-untyped-def]
    """A constant picture of uniform noise: relmse(n) = k / n is known, so is where the rule must stop."""
    task = make_task(stop={"relative_error": 0.06})
    told = []
    result = JobRunner(fake_engine(), task, on_progress=lambda state, progress: told.append(progress)).run()
    assert result.reason is StopReason.RELATIVE_ERROR
    signal2 = 0.25 * (1 + 0.25 + 4) / 3
    k = (1 / 12) * (1 + 0.25 + 4) / 3 / (signal2 + 0.01)
    needed = k / 0.06**2
    samples = result.end * R
    assert needed <= samples <= 1.6 * needed + 8
    assert told[-1].samples_done == samples  # work beyond the end is dropped, and not counted either
    last = result.record.points[-1]
    assert last.upper <= 0.06**2
    assert result.record.points[-2].upper > 0.06**2
    errors = image_bits(result)
    assert errors == image_bits(
        JobRunner(fake_engine("fake:0,fake:1"), make_task(folder="b", stop={"relative_error": 0.06})).run()
    )


def test_no_batch_is_begun_that_would_most_likely_be_dropped(fake_engine, make_task):  # type: ignore[no-untyped-def]
    """Uniform noise, whose error falls as foreseen: devices wait for the look that ends the picture."""
    runner = JobRunner(fake_engine(), make_task(stop={"relative_error": 0.06}))
    result = runner.run()
    assert result.reason is StopReason.RELATIVE_ERROR
    canvas = runner._course.canvas
    assert canvas.batches.ahead is None
    assert canvas.samples == result.end * R


def image_bits(result):  # type: ignore[no-untyped-def]
    return result.end, picture(result)


def test_a_time_limit_is_kept_and_what_is_past_the_stop_is_dropped(fake_engine, make_task):  # type: ignore[no-untyped-def]
    result = JobRunner(fake_engine(), make_task(stop={"seconds": 1.0})).run()
    assert result.reason is StopReason.SECONDS
    assert 0.5 < result.record.seconds < 2.5
    counts = np.concatenate([b.integers["SampleCount"] for b in result.bands()])
    assert (counts == result.end * R).all()
    samples_rule = make_task(folder="again", stop={"samples": result.end * R})
    assert picture(JobRunner(fake_engine(), samples_rule).run()) == picture(result)


def test_a_full_disk_fails_the_job(fake_engine, make_task, monkeypatch):  # type: ignore[no-untyped-def]
    def full(self, name, data):  # type: ignore[no-untyped-def]
        if name.endswith(".tile"):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    monkeypatch.setattr("penumbra_service.film.tilefile.FolderTileStore.write", full)
    monkeypatch.setattr("penumbra_service.engine.snapshot.save", lambda *_: None)
    task = make_task(memory_limit=1)
    task.folder.mkdir(parents=True)
    (task.folder / "scene.json").write_text(task.scene.model_dump_json())
    result = JobRunner(fake_engine(), task).run()
    assert result.failure.kind == "storage"
    assert "No space left" in result.failure.message


def test_a_crop_has_the_bits_of_the_full_frame(fake_engine, make_task):  # type: ignore[no-untyped-def]
    engine = fake_engine()
    full = JobRunner(engine, make_task(folder="full")).run()
    task = make_task(folder="crop")
    film = task.scene.film.model_copy(update={"crop": type_of_crop(task)(x=24, y=16, width=20, height=30)})
    cropped = JobRunner(engine, replace_scene(task, film=film)).run()
    whole = np.concatenate([b.floats["G"] for b in full.bands()])
    part = np.concatenate([b.floats["G"] for b in cropped.bands()])
    assert np.array_equal(whole[16:46, 24:44], part)
    assert next(iter(cropped.bands())).tile == Tile(24, 16, 20, 30)


def type_of_crop(task):  # type: ignore[no-untyped-def]
    from penumbra_scene.film import Crop

    return Crop


def replace_scene(task, **update):  # type: ignore[no-untyped-def]
    import dataclasses

    return dataclasses.replace(task, scene=task.scene.model_copy(update=update))


def test_a_target_that_no_sample_can_meet_fails_instead_of_going_on_for_ever(fake_engine, make_task):  # type: ignore[no-untyped-def]
    engine = fake_engine()
    result = JobRunner(engine, make_task(name="rejected", stop={"relative_error": 0.1})).run()
    assert result.failure.kind == "scene"
    assert "NaN, infinite or negative" in result.failure.message
    limited = make_task(name="rejected", stop={"relative_error": 0.1, "samples": 64}, folder="limited")
    result = JobRunner(engine, limited).run()
    assert result.reason is StopReason.SAMPLES
    assert result.record.counts.taken == 0
