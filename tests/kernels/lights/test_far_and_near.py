"""The choice by power between lights at infinity and lights in the scene does not depend on how large the scene is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_scene.scene import Scene


def _pmf(reach: float, selection: str, **more: Any) -> np.ndarray[Any, Any]:
    lamp = {"type": "quad", "origin": [0, 3, 0], "u": [1, 0, 0], "v": [0, 0, 1], "emission": {"radiance": 5}}
    ground = {"type": "quad", "origin": [-reach, 0, reach], "u": [2 * reach, 0, 0], "v": [0, 0, -2 * reach]}
    scene = {
        "version": 1,
        "camera": {"type": "perspective"},
        "shapes": [ground, lamp, lamp | {"emission": {"radiance": 15}}],
        "integrator": {"light_selection": selection},
    }
    compiled = compile_scene(Scene.model_validate(scene | more), NoAssets())
    return compiled.arrays["light_table"]["pmf"]


@pytest.mark.parametrize("reach", [1.0, 1e3, 1e6])
def test_far_and_near_lights_have_half_of_the_choice_each(reach: float) -> None:
    sun = {"type": "directional", "direction": [0, -1, 0], "irradiance": 2}
    pmf = _pmf(reach, "power", lights=[sun], environment={"type": "constant", "radiance": 0.3})
    assert pmf.sum() == pytest.approx(1.0, abs=1e-6)
    lamps = [np.abs(pmf - expected).min() for expected in (0.125, 0.375)]
    assert max(lamps) < 1e-6


def test_a_scene_without_lights_at_infinity_goes_by_power_alone() -> None:
    assert sorted(_pmf(10.0, "power")) == pytest.approx([0.25, 0.75], abs=1e-6)


def test_equal_chance_stays_equal() -> None:
    pmf = _pmf(1e4, "uniform", environment={"type": "constant", "radiance": 0.3})
    assert pmf == pytest.approx(np.full(3, 1 / 3), abs=1e-6)
