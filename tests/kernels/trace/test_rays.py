"""The rays that a sum node counts are those that its paths must trace."""

from __future__ import annotations

from typing import Any

import pytest
from penumbra_kernels.nodes import SumNode, Tile, merge
from penumbra_kernels.sums import no_sums

WALL = {"type": "quad", "origin": [-5, -5, -2], "u": [10, 0, 0], "v": [0, 10, 0], "material": "m"}
SIDE = 4


def wall(**sections: Any) -> dict[str, Any]:
    """A wall that fills the picture, with a point light before it."""
    return {
        "camera": {"type": "orthographic", "height": 1},
        "film": {"width": SIDE, "height": SIDE},
        "materials": {"m": {"type": "diffuse", "base_color": 0.5}},
        "shapes": [WALL],
        "lights": [{"type": "point", "position": [0, 0, 0], "intensity": 1}],
        "integrator": {"max_bounces": 0},
        **sections,
    }


@pytest.mark.parametrize("program", ["specialised", "generic"])
@pytest.mark.parametrize(
    ("scene", "rays"),
    [
        (wall(shapes=[]), 1),  # the camera's ray meets nothing
        (wall(lights=[]), 1),  # nothing to ask
        (wall(), 2),
        (wall(integrator={"max_bounces": 0, "shadow_rays": 3}), 4),
        (wall(integrator={"max_bounces": 1}), 3),  # the bounced ray leaves the scene
    ],
)
def test_rays_of_a_wall(render: Any, scene: Any, rays: int, program: str) -> None:
    node = render(scene, samples=16, replicates=2, program=program).node
    assert (node.sums["rays"] == 8 * rays).all()


def test_rays_of_large_nodes_pass_32_bits() -> None:
    """float32 nodes hold 256 samples; their parents count in 64 bits."""
    tile = Tile(0, 0, 1, 1)
    sums = no_sums((1, 1, 1))
    sums["rays"] = 2**32 - 1
    merged = merge(SumNode(tile, 0, 256, sums), SumNode(tile, 256, 256, sums))
    assert merged.sums.wide
    assert int(merged.sums["rays"][0, 0, 0]) == 2 * (2**32 - 1)
