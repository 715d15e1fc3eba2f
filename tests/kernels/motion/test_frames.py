"""A frame of an animated scene is the still scene of that moment: shapes, lights and camera alike."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_scene.scene import Scene


def keyed(first: float, last: float) -> dict[str, Any]:
    """Moves evenly along x from time 0 to 1."""
    return {
        "keyframes": [
            {"time": t, "transform": [{"translate": [x, 0, 1]}]} for t, x in ((0, first), (1, last))
        ]
    }


def still(x: float) -> list[dict[str, Any]]:
    return [{"translate": [x, 0, 1]}]


SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": still(0.0)},
    "film": {"width": 16, "height": 16},
    "shapes": [
        {"type": "sphere"},
        {"type": "quad", "emission": {"radiance": 1}},
        {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "indices": [[0, 1, 2]]},
    ],
    "lights": [
        {"type": "point"},
        {"type": "spot"},
    ],
}
PLACES = [("shapes", 0), ("shapes", 1), ("shapes", 2), ("lights", 0), ("lights", 1)]


def compiled(place: tuple[str, int], transform: Any, time: float) -> CompiledScene:
    scene = copy.deepcopy(SCENE)
    scene[place[0]][place[1]]["transform"] = transform
    return compile_scene(Scene.model_validate(scene), NoAssets(), time)


@pytest.mark.parametrize("place", PLACES, ids=lambda place: f"{place[0]} {place[1]}")
def test_a_frame_is_the_still_scene_of_its_moment(place: tuple[str, int]) -> None:
    moving = compiled(place, keyed(-1.0, 3.0), 0.25)
    fixed = compiled(place, still(0.0), 0.25)
    assert moving.arrays.keys() == fixed.arrays.keys()
    for name, array in moving.arrays.items():
        assert array.tobytes() == fixed.arrays[name].tobytes(), name
    elsewhere = compiled(place, still(1.0), 0.25)
    assert any(elsewhere.arrays[name].tobytes() != array.tobytes() for name, array in moving.arrays.items())


def test_a_moving_camera_looks_from_where_it_is() -> None:
    scene = copy.deepcopy(SCENE)
    scene["camera"]["transform"] = keyed(-1.0, 3.0)
    moving = compile_scene(Scene.model_validate(scene), NoAssets(), 0.5)
    scene["camera"]["transform"] = still(1.0)
    fixed = compile_scene(Scene.model_validate(scene), NoAssets(), 0.5)
    # the anchor is where the camera stands at its first keyframe, so places differ by 2 along x and nothing else
    ours, theirs = (s.params["camera"]["world_from_camera"] for s in (moving, fixed))
    assert np.allclose(ours[..., :3], theirs[..., :3])
    assert np.allclose(ours[..., 0, 3] - theirs[..., 0, 3], 2.0)
