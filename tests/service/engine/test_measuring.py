"""What effects cost: a whole measurement, and what happens where nothing can be measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.device import devices
from penumbra_service.explain import explain, table
from penumbra_service.measuring import MeasureError, Request, for_receipt, measure_effects

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {
        "type": "perspective",
        "transform": [{"translate": [0, 0.5, 3]}],
        "lens": {"aperture_radius": 0.05, "focus_distance": 3},
    },
    "film": {"width": 64, "height": 64},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "plane"}, {"type": "sphere", "radius": 0.5}],
    "lights": [{"type": "point", "position": [2, 3, 2]}],
}


@pytest.mark.skipif(not devices(), reason="no OpenCL device")
def test_a_scenes_effects_are_measured_in_seconds_and_in_noise(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    measured = measure_effects(Request(str(path), None, None, 0.0, None, 0.5))
    assert [row.group for row in measured.noise] == ["pixel", "lens", "interactions"]
    assert sum(row.alone for row in measured.noise) == pytest.approx(1, abs=1e-9)
    assert [cost.effect for cost in measured.costs] == ["lens", "delta_lights"]
    assert all(cost.seconds > 0 and cost.seconds_without > 0 for cost in measured.costs)
    assert "interactions" in table(measured)


@pytest.mark.skipif(not devices(), reason="no OpenCL device")
def test_effects_are_those_of_a_picture_with_its_own_number_of_shadow_rays(tmp_path: Path) -> None:
    """An adaptive picture may have taken fewer than the scene asks for: its noise is that of a scene with so many."""
    lamp = {
        "type": "quad",
        "origin": [-1, 3, -1],
        "u": [2, 0, 0],
        "v": [0, 0, 2],
        "emission": {"radiance": 3},
    }
    noise = {}
    for name, given, taken in (("four", 4, 0), ("one of four", 4, 1), ("one", 1, 0)):
        path = tmp_path / f"{name}.json"
        integrator = {"max_bounces": 0, "shadow_rays": given}
        path.write_text(json.dumps({**SCENE, "shapes": [*SCENE["shapes"], lamp], "integrator": integrator}))
        measured = measure_effects(Request(str(path), None, None, 0.0, None, 0.1, taken))
        noise[name] = [(row.group, row.alone) for row in measured.noise]
    assert noise["one of four"] == noise["one"]
    assert dict(noise["one"])["lights"] > dict(noise["four"])["lights"]


@pytest.mark.skipif(not devices(), reason="no OpenCL device")
def test_errors_of_a_film_of_one_block_are_said_to_be_unknown(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({**SCENE, "film": {"width": 8, "height": 8}}))
    measured = measure_effects(Request(str(path), None, None, 0.0, None, 0.1))
    assert measured.blocks == 1
    told = json.loads(explain(path, as_json=True, measured=measured))["measured"]["noise"]
    assert told
    assert all(row["error"] is None and row["typical_error"] is None for row in told)
    text = table(measured)
    assert text.count("+-    ? %") == 2 * len(told)
    assert "unknown" in text
    assert "noisiest" not in text, "a block alone is no few of many"


def test_a_picture_is_not_lost_where_nothing_can_be_measured(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    with pytest.raises(MeasureError, match="nonesuch:7"):
        measure_effects(Request(str(tmp_path / "scene.json"), None, None, 0.0, "nonesuch:7", 1.0))
    measured, warnings = for_receipt(tmp_path, 0.0, ["nonesuch:7"], tmp_path)
    assert measured is None
    assert "nonesuch:7" in warnings[0]
