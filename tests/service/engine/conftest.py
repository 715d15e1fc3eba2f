"""Engines on fake devices, tasks of small scenes, and pictures as bytes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from penumbra_scene.job import JobState
from penumbra_scene.scene import Scene
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.runner import Halt, JobRunner, RenderTask, RunResult
from penumbra_service.film.levels import NAME as MAP

COMMAND = (sys.executable, str(Path(__file__).with_name("fake_device.py")))


@pytest.fixture(scope="module")
def fake_engine() -> Iterator[Callable[..., LocalEngine]]:
    """fake_engine(devices='fake:0', broken=''): a started engine, one for the same arguments."""
    started: dict[tuple[str, str], LocalEngine] = {}

    def make(devices: str = "fake:0", broken: str = "") -> LocalEngine:
        key = (devices, broken)
        if key not in started:
            variables = {"FAKE_DEVICES": devices, "FAKE_BROKEN": broken}
            command = ("env", *(f"{name}={value}" for name, value in variables.items()), *COMMAND)
            started[key] = LocalEngine(command=command)
            started[key].start()
        return started[key]

    yield make
    for engine in started.values():
        engine.stop()


@pytest.fixture
def make_task(tmp_path: Path) -> Callable[..., RenderTask]:
    """make_task(name, stop={...}, folder='job', width=.., height=.., sampler={...})."""

    def make(
        name: str = "plain", stop: dict[str, Any] | None = None, folder: str = "job", **more: Any
    ) -> RenderTask:
        scene = Scene.model_validate(
            {
                "version": 1,
                "name": name,
                "camera": {"type": "perspective"},
                "film": {"width": more.pop("width", 80), "height": more.pop("height", 72)},
                "sampler": more.pop("sampler", {"type": "independent"}),
                "stop": stop or {"samples": 32},
            }
        )
        return RenderTask(more.pop("job", folder), scene, tmp_path / folder, **more)

    return make


@pytest.fixture
def small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small tiles, leases of a few samples, and a report of each, so that a short run can be met in its middle."""
    monkeypatch.setattr("penumbra_service.jobs.planning.FIRST_LEASE_SAMPLES", 8)
    monkeypatch.setattr("penumbra_service.jobs.planning.MAX_GROWTH", 1)
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    monkeypatch.setattr("penumbra_service.engine.reporter.PROGRESS_SECONDS", 0.0)


def paused_and_resumed(engine: LocalEngine, task: RenderTask, moment: str) -> RunResult:
    """An adaptive run that is stopped "in the pilot" or "in the picture", and goes on."""

    def halt(state: JobState, progress: Any) -> None:
        decided = (task.folder / "tiles" / MAP).exists()
        started = runner._course.canvas.samples > (8 if decided else 0)
        if decided == (moment == "in the picture") and started:
            runner.halt(Halt.PAUSE)

    runner = JobRunner(engine, task, on_progress=halt)
    assert runner.run().state is JobState.PAUSED
    resumed = JobRunner(engine, task).run()
    assert resumed.state is JobState.FINISHING, resumed.failure
    return resumed


def picture(result: RunResult) -> bytes:
    """All channels of a finished run, however it was banded."""
    channels: dict[str, list[bytes]] = {}
    for band in result.bands():
        for name, values in (*band.floats.items(), *band.integers.items()):
            channels.setdefault(name, []).append(values.tobytes())
    return b"".join(b"".join(rows) for rows in channels.values())
