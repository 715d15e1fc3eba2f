"""A lamp that emits outwards alone lights nothing inside of itself, its own surface least of all."""

from __future__ import annotations

from typing import Any

import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.parse import scene_from_json


def seen_from_inside(at: list[float], ball: dict[str, Any]) -> dict[str, Any]:
    """A camera near the middle of a white ball, all of whose outside shines."""
    return {
        "version": 1,
        "camera": {"type": "perspective", "transform": {"translate": [a + 0.3 for a in at]}},
        "film": {"width": 8, "height": 8},
        "materials": {"white": {"type": "diffuse", "base_color": 0.9}},
        "shapes": [{"type": "sphere", "material": "white", "emission": {"radiance": 1}, **ball}],
    }


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize(
    ("at", "ball"),
    [
        ([0, 0, 0], {"radius": 8}),
        ([0, 0, 0], {"radius": 1e6}),
        ([300, -20, 0], {"center": [300, -20, 0], "radius": 2}),
        ([0, 3, 0], {"radius": 1, "transform": [{"scale": 5}, {"rotate": {"axis": [1, 2, 3], "angle": 50}},
                                                {"translate": [0, 3, 0]}]}),
    ],
)  # fmt: skip
def test_no_light_leaks_into_a_ball_that_shines_outwards(
    device: Device, at: list[float], ball: dict[str, Any], together: bool
) -> None:
    scene = scene_from_json(seen_from_inside(at, ball))
    tracer = Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(4), together=together)
    sums = tracer.trace(Tile(0, 0, 8, 8), 0, 64).sums
    assert sums["taken"].sum() == 8 * 8 * 4 * 64
    assert sums["lit"].sum() == 0
