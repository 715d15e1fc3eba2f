"""Whole jobs on this machine's devices through the real tracer: the same bits whatever happens on the way."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_scene.job import JobState, StopReason
from penumbra_scene.limits import MAX_ALBEDO_TABLES
from penumbra_scene.scene import Scene
from penumbra_service.engine.local import LocalEngine, list_devices
from penumbra_service.engine.runner import Halt, JobRunner, RenderTask, RunResult
from penumbra_service.images.limits import DecodeLimits
from penumbra_service.store.content import asset_file

pytestmark = pytest.mark.skipif(not list_devices(), reason="no OpenCL device")

SCENE: dict[str, Any] = {
    "version": 1,
    "name": "ball",
    "camera": {"type": "perspective", "transform": [{"translate": [0, 0.5, 3]}]},
    "film": {"width": 40, "height": 32, "layers": ["albedo", "normal", "depth"]},
    "sampler": {"type": "sobol", "seed": 11},
    "stop": {"samples": 32},
    "materials": {"white": {"type": "diffuse", "base_color": 0.6}},
    "shapes": [
        {"type": "plane", "material": "white"},
        {"type": "sphere", "material": "white", "transform": [{"translate": [0, 0.5, 0]}, {"scale": 0.5}]},
    ],
    "environment": {"type": "constant", "radiance": 1.0},
}


@pytest.fixture(scope="module")
def engine() -> Iterator[LocalEngine]:
    with LocalEngine([list_devices()[0].id]) as engine:
        yield engine


def _task(folder: Path, **sections: Any) -> RenderTask:
    return RenderTask(folder.name, Scene.model_validate({**SCENE, **sections}), folder)


def _channels(result: RunResult) -> dict[str, np.ndarray[Any, Any]]:
    assert result.state is JobState.FINISHING, result.failure
    bands = list(result.bands())
    return {
        name: np.concatenate([(b.floats | b.integers)[name] for b in bands])
        for name in (*bands[0].floats, *bands[0].integers)
    }


def _same(a: dict[str, np.ndarray[Any, Any]], b: dict[str, np.ndarray[Any, Any]]) -> bool:
    return a.keys() == b.keys() and all(a[name].tobytes() == b[name].tobytes() for name in a)


@pytest.fixture(scope="module")
def reference(
    engine: LocalEngine, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, np.ndarray[Any, Any]]:
    return _channels(JobRunner(engine, _task(tmp_path_factory.mktemp("reference"))).run())


def test_the_parent_does_not_import_pyopencl(reference):  # type: ignore[no-untyped-def]
    """The tests' own conftest does; so ask a fresh interpreter that imports all that the parent needs."""
    import subprocess

    code = (
        "import sys, penumbra_service.engine.runner, penumbra_service.engine.local; "
        "sys.exit('pyopencl' in sys.modules or 'OpenImageIO' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_picture_makes_sense(reference):  # type: ignore[no-untyped-def]
    assert (reference["SampleCount"] == 32).all()
    assert (reference["InvalidCount"] == 0).all()
    assert set(np.unique(reference["ID"])) == {0, 1, 2}
    sky = reference["ID"] == 0
    assert (reference["R"][sky & (reference["A"] == 0)] == 1).all()
    assert (reference["Variance.R"] >= 0).all()
    assert 0.05 < reference["R"][~sky].mean() < 1


@pytest.mark.parametrize("size", [16, 32])
def test_bits_do_not_depend_on_tiles(engine, reference, tmp_path, monkeypatch, size):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", size)
    assert _same(_channels(JobRunner(engine, _task(tmp_path)).run()), reference)


def test_bits_do_not_depend_on_lease_sizes(engine, reference, tmp_path, monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.jobs.planning.FIRST_LEASE_SAMPLES", 8)
    monkeypatch.setattr("penumbra_service.jobs.planning.MAX_GROWTH", 1)
    monkeypatch.setattr("penumbra_service.jobs.planning.LEAST_SECONDS", 0.0)
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    result = JobRunner(engine, _task(tmp_path)).run()
    assert sum(use.leases for use in result.record.devices.values()) >= 8
    assert _same(_channels(result), reference)


def test_the_generic_program_gives_the_same_bits(engine, reference, tmp_path):  # type: ignore[no-untyped-def]
    task = dataclasses.replace(_task(tmp_path), program="generic")
    result = JobRunner(engine, task).run()
    assert {use.program for use in result.record.programs} == {"generic"}
    assert not all(effect.present for effect in result.record.effects)  # the scene's, not the program's
    assert _same(_channels(result), reference)


def test_a_killed_process_costs_time_and_nothing_else(engine, tmp_path):  # type: ignore[no-untyped-def]
    sections = {"stop": {"samples": 8192}, "sampler": {"type": "independent"}}
    undisturbed = _channels(JobRunner(engine, _task(tmp_path / "a", **sections)).run())
    slot = engine._slots[0]
    killed = []

    def kill_soon() -> None:
        end = time.monotonic() + 30
        while time.monotonic() < end:
            held = next(iter(slot.held.values()), None)
            # Midway, where there is always more to do: a process that rests when it dies is not to blame.
            midway = held is not None and held.lease.job == "b" and held.lease.items[0].first >= 256
            if slot.running is not None and midway:
                os.kill(slot.process.pid, signal.SIGKILL)
                killed.append(slot.running)
                return
            time.sleep(0.001)

    killer = threading.Thread(target=kill_soon)
    killer.start()
    result = JobRunner(engine, _task(tmp_path / "b", **sections)).run()
    killer.join()
    assert killed
    assert result.record.crashes == 1
    assert _same(_channels(result), undisturbed)


def test_a_paused_job_goes_on_with_the_same_bits(engine, tmp_path):  # type: ignore[no-untyped-def]
    sections = {"stop": {"relative_error": 0.02, "samples": 4096}}
    whole = JobRunner(engine, _task(tmp_path / "a", **sections)).run()
    assert whole.reason is StopReason.RELATIVE_ERROR
    task = _task(tmp_path / "b", **sections)
    runner = JobRunner(
        engine,
        task,
        on_progress=lambda state, progress: progress.samples_done >= 16 and runner.halt(Halt.PAUSE),
    )
    assert runner.run().state is JobState.PAUSED
    resumed = JobRunner(engine, task).run()
    assert resumed.end == whole.end
    assert resumed.record.ends == whole.record.ends
    assert _same(_channels(resumed), _channels(whole))


@pytest.mark.parametrize("sampler", ["regular", "random", "stratified"])
def test_samplers_with_other_statistics(engine, tmp_path, sampler):  # type: ignore[no-untyped-def]
    result = JobRunner(engine, _task(tmp_path, sampler={"type": sampler}, stop={"samples": 16})).run()
    channels = _channels(result)
    if sampler == "regular":
        assert np.isnan(channels["Variance.R"]).all()
        assert (channels["SampleCount"] == 16).all()
    elif sampler == "random":
        assert len(np.unique(channels["SampleCount"])) > 3
        assert channels["SampleCount"].sum() == 16 * 40 * 32
    else:
        assert np.isfinite(channels["Variance.R"]).all()


def test_a_scene_that_cannot_be_prepared_fails_at_once_with_the_reason(engine, tmp_path):  # type: ignore[no-untyped-def]
    """More rough materials than there are tables for: no number of attempts would mend it."""
    rough = {
        f"m{i}": {"type": "conductor", "roughness": 0.2 + i * 1e-4} for i in range(MAX_ALBEDO_TABLES + 1)
    }
    shapes = [{"type": "sphere", "material": name} for name in rough]
    sections = {"materials": {**SCENE["materials"], **rough}, "shapes": [*SCENE["shapes"], *shapes]}
    result = JobRunner(engine, _task(tmp_path / "job", **sections)).run()
    assert result.failure is not None
    assert result.failure.kind == "scene"
    assert "rough materials" in result.failure.message


def test_a_device_decodes_assets_within_the_services_limits(engine, tmp_path):  # type: ignore[no-untyped-def]
    data = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    digest = hashlib.sha256(data).hexdigest()
    file = asset_file(tmp_path / "assets", digest)
    file.parent.mkdir(parents=True)
    file.write_bytes(data)
    shapes = [{"type": "mesh", "source": {"asset": f"sha256:{digest}"}}]
    task = dataclasses.replace(
        _task(tmp_path / "job", shapes=shapes),
        assets_folder=tmp_path / "assets",
        decode=DecodeLimits(file_bytes=len(data) - 1),
    )
    failure = JobRunner(engine, task).run().failure
    assert failure is not None
    assert failure.kind == "scene"
    assert f"at most {len(data) - 1} are accepted" in failure.message


def test_a_missing_asset_fails_the_job_and_names_it(engine, tmp_path):  # type: ignore[no-untyped-def]
    environment = {"type": "image", "image": {"asset": "sha256:" + "0" * 64}}
    folder = tmp_path / "assets"
    folder.mkdir()
    task = dataclasses.replace(_task(tmp_path / "job", environment=environment), assets_folder=folder)
    result = JobRunner(engine, task).run()
    assert result.failure is not None
    assert result.failure.kind == "scene"
    assert "sha256:0000" in result.failure.message
