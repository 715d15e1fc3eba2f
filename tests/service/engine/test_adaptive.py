"""Adaptive jobs on this machine's devices: the same bits whatever happens on the way, and as many samples as were asked
for."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_scene.job import JobState, StopReason
from penumbra_scene.scene import Scene
from penumbra_service.engine.local import LocalEngine, list_devices
from penumbra_service.engine.runner import JobRunner, RenderTask, RunResult
from penumbra_service.film.allocation import BLOCK
from penumbra_service.film.levels import NAME

from tests.service.engine.conftest import paused_and_resumed, picture

pytestmark = pytest.mark.skipif(not list_devices(), reason="no OpenCL device")

SIDE = 48
SCENE: dict[str, Any] = {
    "version": 1,
    "name": "shadow",
    "camera": {"type": "perspective", "transform": {"look_at": {"origin": [0, 2, 4], "target": [0, 0.3, 0]}}},
    "film": {"width": SIDE, "height": SIDE, "layers": ["albedo"]},
    "sampler": {"type": "sobol", "seed": 3},
    "integrator": {"max_bounces": 0},
    "materials": {"white": {"type": "diffuse", "base_color": 0.6}},
    "shapes": [
        {"type": "plane", "material": "white"},
        {"type": "sphere", "material": "white", "center": [0, 0.5, 0], "radius": 0.5},
        {"type": "quad", "origin": [-1, 3, -1], "u": [2, 0, 0], "v": [0, 0, 2], "emission": {"radiance": 3}},
    ],
}
CERTIFIED = {"strategy": "error", "pilot_samples": 16}
FAST = {"strategy": "error", "mode": "fast", "pilot_samples": 16}
CONTRAST = {"strategy": "contrast", "pilot_samples": 8}
WAYS = [CERTIFIED, FAST, CONTRAST]


@pytest.fixture(scope="module")
def engine() -> Iterator[LocalEngine]:
    with LocalEngine([list_devices()[0].id]) as engine:
        yield engine


def task_of(folder: Path, adaptive: dict[str, Any], **sections: Any) -> RenderTask:
    scene = {**SCENE, "adaptive": adaptive, "stop": {"samples": 64}, **sections}
    return RenderTask(folder.name, Scene.model_validate(scene), folder)


def finished(engine: LocalEngine, task: RenderTask) -> RunResult:
    result = JobRunner(engine, task).run()
    assert result.state is JobState.FINISHING, result.failure
    return result


def counts(result: RunResult) -> np.ndarray[Any, Any]:
    return np.concatenate([band.integers["SampleCount"] for band in result.bands()])


@pytest.mark.parametrize("way", WAYS)
def test_bits_do_not_depend_on_tiles_leases_or_the_program(engine, tmp_path, monkeypatch, way):  # type: ignore[no-untyped-def]
    whole = picture(finished(engine, task_of(tmp_path / "a", way)))
    monkeypatch.setattr("penumbra_service.jobs.planning.FIRST_LEASE_SAMPLES", 8)
    monkeypatch.setattr("penumbra_service.jobs.planning.MAX_GROWTH", 1)
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    generic = dataclasses.replace(task_of(tmp_path / "b", way), program="generic")
    assert picture(finished(engine, generic)) == whole


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("moment", ["in the pilot", "in the picture"])
def test_a_run_that_was_stopped_goes_on_with_the_same_bits(engine, tmp_path, small_steps, way, moment):  # type: ignore[no-untyped-def]
    sections = {"stop": {"relative_error": 0.012, "samples": 512}}
    whole = finished(engine, task_of(tmp_path / "a", way, **sections))
    resumed = paused_and_resumed(engine, task_of(tmp_path / "b", way, **sections), moment)
    assert resumed.end == whole.end
    assert resumed.record.ends == whole.record.ends
    assert picture(resumed) == picture(whole)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("moment", ["in the pilot", "in the picture"])
def test_a_device_that_is_killed_costs_no_bits(engine, tmp_path, small_steps, way, moment):  # type: ignore[no-untyped-def]
    sections = {"stop": {"samples": 2048}}
    whole = finished(engine, task_of(tmp_path / "a", way, **sections))
    task = task_of(tmp_path / "b", way, **sections)
    with LocalEngine([list_devices()[0].id]) as mortal:
        killed: list[int] = []

        def kill(state: JobState, progress: Any) -> None:
            decided = (task.folder / "tiles" / NAME).exists()
            there = progress.seconds > 0 and progress.progress < 0.9
            if not killed and there and decided == (moment == "in the picture"):
                killed.append(device_process())
                os.kill(killed[0], signal.SIGKILL)

        def device_process() -> int:
            """The newest process of a device below this one: that of `mortal`."""
            tasks = Path(f"/proc/{os.getpid()}/task").iterdir()
            below = [int(word) for task in tasks for word in (task / "children").read_text().split()]
            driven = [
                pid for pid in below if b"engine.device_process" in Path(f"/proc/{pid}/cmdline").read_bytes()
            ]
            return max(driven)

        result = JobRunner(mortal, task, on_progress=kill).run()
    assert result.state is JobState.FINISHING, result.failure
    assert killed
    assert picture(result) == picture(whole)
    assert result.record.ends[-1] == whole.record.ends[-1]


@pytest.mark.parametrize("way", WAYS)
def test_a_lost_map_starts_the_picture_again_with_the_same_bits(engine, tmp_path, way):  # type: ignore[no-untyped-def]
    task = task_of(tmp_path / "a", way)
    whole = picture(finished(engine, task))
    path = task.folder / "tiles" / NAME
    path.write_bytes(path.read_bytes()[:-1])
    assert picture(finished(engine, task)) == whole


@pytest.mark.parametrize("way", WAYS)
def test_samples_are_the_mean_over_the_pixels(engine, tmp_path, way):  # type: ignore[no-untyped-def]
    result = finished(engine, task_of(tmp_path, way))
    found = counts(result)
    assert result.reason is StopReason.SAMPLES
    one_block = BLOCK**2 * found.max() / 2 / SIDE**2  # what another one on the next level would change
    assert abs(found.mean() - 64) <= (0.06 * 64 if way is CONTRAST else one_block / 2)
    assert found.min() < 64 < found.max()
    assert result.record.points[-1].samples == pytest.approx(found.mean())
    assert result.record.foretold is not None
    assert result.record.foretold.samples == pytest.approx(
        found.mean(), rel=0.06
    )  # the picture's, not the pilot's
    use = result.record.adaptive
    assert use is not None
    assert sum(use.levels.values()) == SIDE * SIDE


def test_blocks_share_a_level_and_none_is_starved(engine, tmp_path):  # type: ignore[no-untyped-def]
    found = counts(finished(engine, task_of(tmp_path, CERTIFIED)))
    blocks = found.reshape(SIDE // BLOCK, BLOCK, SIDE // BLOCK, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)
    assert (blocks == blocks[:, :1]).all()
    assert (
        found.min() >= 0.25 / 2**0.5 * found.mean() - 8
    )  # a quarter, to the nearest level, rounded to replicates


def test_a_picture_without_contrast_ends_with_its_first_samples(engine, tmp_path):  # type: ignore[no-untyped-def]
    flat = {"shapes": [], "environment": {"type": "constant", "radiance": 1}}
    for stop in ({"samples": 64}, {"seconds": 60}, {"relative_error": 0.5, "seconds": 60}):
        result = finished(engine, task_of(tmp_path / str(len(stop)), CONTRAST, stop=stop, **flat))
        assert (counts(result) == 8).all()


def test_only_pixels_with_contrast_are_refined(engine, tmp_path):  # type: ignore[no-untyped-def]
    """A disc that shines before nothing, by the deterministic sampler: its rim, and the pixels beside it."""
    disc = {"shapes": [{"type": "disc", "radius": 0.5, "emission": {"radiance": 1}}]}
    camera = {"type": "orthographic", "height": 2, "transform": {"translate": [0, 0, 3]}}
    sections = {"camera": camera, "sampler": {"type": "regular"}, "stop": {"samples": 16}, **disc}
    way = {"strategy": "contrast", "pilot_samples": 4}
    result = finished(engine, task_of(tmp_path, way, **sections))
    refined = counts(result) > 4
    centre = (np.arange(SIDE) + 0.5) * 2 / SIDE - 1
    distance = np.hypot(centre[:, None], centre[None, :])
    pixel = 2 / SIDE
    assert refined[np.abs(distance - 0.5) < 0.2 * pixel].all()
    assert not refined[np.abs(distance - 0.5) > 2.2 * pixel].any()


def test_a_pilot_grows_with_what_the_picture_will_take(engine, tmp_path):  # type: ignore[no-untyped-def]
    """By default: at least 8 samples a pixel, and as many more as are at most 1/24 of an even picture's."""
    pilots = []
    for name, stop in (("a", {"samples": 64}), ("b", {"samples": 2048}), ("c", {"relative_error": 0.004})):
        result = finished(engine, task_of(tmp_path / name, {"strategy": "error"}, stop=stop))
        assert result.record.adaptive is not None
        pilots.append(result.record.adaptive.pilot_samples)
    assert pilots[:2] == [8, 64]
    assert 8 < pilots[2] <= result.record.points[-1].samples / 4


def test_a_pilot_takes_at_most_its_share_of_the_time(engine, tmp_path):  # type: ignore[no-untyped-def]
    way = {"strategy": "error", "pilot_samples": 4096}
    large = {"width": 192, "height": 192}  # no machine takes the whole pilot in a tenth of the time
    result = finished(engine, task_of(tmp_path, way, stop={"seconds": 2}, film=large))
    use = result.record.adaptive
    assert use is not None
    assert use.pilot_samples < 4096
    assert result.reason is StopReason.SECONDS


def test_where_spreading_saves_nothing_all_pixels_take_as_many(engine, tmp_path):  # type: ignore[no-untyped-def]
    """A picture that is nothing but one lamp's light on a plane has the same noise everywhere."""
    scene = {
        "camera": {"type": "perspective"},
        "shapes": [
            {"type": "quad", "origin": [-9, -9, -3], "u": [18, 0, 0], "v": [0, 18, 0], "material": "white"}
        ],
        "environment": {"type": "constant", "radiance": 1.0},
    }
    result = finished(engine, task_of(tmp_path, CERTIFIED, **scene))
    assert result.record.adaptive is not None
    assert set(result.record.adaptive.levels) == {"0"}
    assert "saves nothing" in " ".join(result.record.warnings)
    assert (counts(result) == 64).all()
