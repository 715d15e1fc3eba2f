"""Adaptive jobs decide by their pilot how many of the scene's shadow rays pay: once, whatever happens on the way, and the
picture is that of a scene which has so many."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from penumbra_scene.job import JobRequest, JobState
from penumbra_scene.parse import parse_scene
from penumbra_scene.scene import Scene
from penumbra_service.engine.local import LocalEngine, list_devices
from penumbra_service.engine.pilot import PilotRunner, PilotTask
from penumbra_service.engine.runner import JobRunner, RenderTask, RunResult
from penumbra_service.engine.task import FixedPlan
from penumbra_service.jobs.quote import build_quote
from penumbra_service.rendering import render
from penumbra_service.replay import replay

from tests.service.engine.conftest import paused_and_resumed, picture
from tests.service.engine.test_adaptive import SCENE as SHADOW
from tests.service.test_replay import _channels

pytestmark = pytest.mark.skipif(not list_devices(), reason="no OpenCL device")

SCENE: dict[str, Any] = {
    **SHADOW,
    "environment": {"type": "constant", "radiance": 0.5},
    "integrator": {"max_bounces": 2, "light_selection": "all", "shadow_rays": 8},
    "stop": {"relative_error": 0.03},
}
"""The room's own light and a lamp, each asked eight times a hit."""
CERTIFIED = {"mode": "certified"}
FAST = {"mode": "fast"}
WAYS = [CERTIFIED, FAST]


@pytest.fixture(scope="module")
def engine() -> Iterator[LocalEngine]:
    with LocalEngine([list_devices()[0].id]) as engine:
        yield engine


def document(adaptive: dict[str, Any] | None, **sections: Any) -> dict[str, Any]:
    return {**SCENE, "adaptive": adaptive, **sections}


def task_of(
    folder: Path, adaptive: dict[str, Any], fixed: FixedPlan | None = None, **sections: Any
) -> RenderTask:
    return RenderTask(folder.name, Scene.model_validate(document(adaptive, **sections)), folder, fixed=fixed)


def finished(engine: LocalEngine, task: RenderTask) -> RunResult:
    result = JobRunner(engine, task).run()
    assert result.state is JobState.FINISHING, result.failure
    return result


def test_the_picture_is_that_of_a_scene_with_so_many_shadow_rays(engine, tmp_path):  # type: ignore[no-untyped-def]
    """With the same map, which is given to that scene."""
    chosen = finished(engine, task_of(tmp_path / "a", CERTIFIED))
    use = chosen.record.adaptive
    assert use is not None
    assert chosen.levels is not None
    assert use.shadow_rays == chosen.levels.shadow_rays
    assert 1 <= use.shadow_rays < 8
    few = {**SCENE["integrator"], "shadow_rays": use.shadow_rays}
    plan = FixedPlan(chosen.end, chosen.levels, use)
    again = finished(engine, task_of(tmp_path / "b", CERTIFIED, plan, integrator=few))
    assert picture(again) == picture(chosen)


@pytest.mark.parametrize(
    "way", [{"shadow_rays": "exactly"}, {"stop": {"samples": 64}}, {"sampler": {"replicates": 2}}]
)
def test_hits_take_all_shadow_rays_where_nothing_is_to_be_decided(engine, tmp_path, way):  # type: ignore[no-untyped-def]
    """It is asked for; samples end the picture, which would be noisier with fewer; half of two replicates has no variance."""
    section = {key: value for key, value in way.items() if key == "shadow_rays"}
    sections = {key: value for key, value in way.items() if key != "shadow_rays"}
    result = finished(engine, task_of(tmp_path / "a", section, **sections))
    assert result.record.adaptive is not None
    assert result.record.adaptive.shadow_rays == 0
    assert result.levels is not None
    plan = FixedPlan(result.end, result.levels, result.record.adaptive)
    again = finished(engine, task_of(tmp_path / "b", section, plan, **sections))
    assert picture(again) == picture(result)
    counts = result.record.counts
    assert counts is not None
    assert counts.rays > 10 * counts.taken  # of 1 + 16 and more of a path that meets the ground


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("moment", ["in the pilot", "in the picture"])
def test_a_run_that_was_stopped_goes_on_with_the_same_bits(engine, tmp_path, small_steps, way, moment):  # type: ignore[no-untyped-def]
    way = {**way, "pilot_samples": 16}
    whole = finished(engine, task_of(tmp_path / "a", way))
    resumed = paused_and_resumed(engine, task_of(tmp_path / "b", way), moment)
    assert resumed.record.adaptive is not None
    assert 1 <= resumed.record.adaptive.shadow_rays < 8
    assert picture(resumed) == picture(whole)


@pytest.mark.parametrize("way", WAYS)
def test_a_receipt_brings_the_same_bits_again(tmp_path, way):  # type: ignore[no-untyped-def]
    """Those of the fast way's first samples too, half of whose replicates took one ray."""
    (tmp_path / "scene.json").write_text(json.dumps(document(way)))
    scene = parse_scene((tmp_path / "scene.json").read_bytes(), allow_files=True)
    device = list_devices()[0].id
    (old,) = render(JobRequest(scene=scene), tmp_path, tmp_path, device, lambda event: None)
    assert old.adaptive is not None
    assert old.adaptive.shadow_rays is not None
    assert 1 <= old.adaptive.shadow_rays < 8
    assert old.adaptive.map is not None
    assert old.adaptive.map.kept_shadow_rays == ((1, 8) if way is FAST else (0, 0))
    again = tmp_path / "again"
    again.mkdir()
    new, doubts = replay(tmp_path / "receipt.json", tmp_path / "scene.json", again, device)
    assert doubts == []
    assert new.adaptive is not None
    assert new.adaptive.shadow_rays == old.adaptive.shadow_rays
    assert _channels(again / "result.exr") == _channels(tmp_path / "result.exr")


def test_a_quote_counts_on_fewer_shadow_rays(engine, tmp_path):  # type: ignore[no-untyped-def]
    """Samples are more, as many as the job then takes, and each has fewer rays."""
    stop = {"relative_error": 0.006}
    real = finished(engine, task_of(tmp_path / "job", CERTIFIED, stop=stop)).record
    told, rays = {}, {}
    for name, choice in (("fewer", None), ("all", "exactly")):
        scene = Scene.model_validate(document({"shadow_rays": choice}, stop=stop))
        found = PilotRunner(engine, PilotTask(scene, tmp_path / name)).run()
        assert found.saving is not None
        told[name], rays[name] = build_quote(scene, 0.0, found), found.saving.cost
    assert real.points[-1].samples / 1.5 < told["fewer"].end.samples < real.points[-1].samples * 1.5
    assert told["fewer"].end.samples > told["all"].end.samples
    assert rays["fewer"] < 0.75 < rays["all"]
