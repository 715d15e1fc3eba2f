"""Which shapes have an area, and so can be seen and give light."""

from __future__ import annotations

import math
from typing import Any

import pytest
from penumbra_scene.area import LEAST_AREA, emits, has_area
from penumbra_scene.scene import Scene

SIDE = math.sqrt(LEAST_AREA)
"""Of a square of the least area, metres: 1e-19."""
TURN = {"rotate": {"axis": [1, 2, 3], "angle": 40}}


def shape(**keys: Any) -> Any:
    scene = {"version": 1, "camera": {"type": "perspective"}, "shapes": [keys]}
    return Scene.model_validate(scene).shapes[0]


def square(side: float, *transform: Any) -> Any:
    return shape(type="quad", u=[side, 0, 0], v=[0, side, 0], transform=list(transform))


def triangle(size: float, third: list[float], **more: Any) -> Any:
    positions = [[size * x for x in corner] for corner in ([0, 0, 0], [1, 1, 1], third)]
    return shape(type="mesh", positions=positions, indices=[[0, 1, 2]], **more)


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_an_area_is_one_from_the_least_on_however_it_is_placed(factor: float) -> None:
    there = factor > 1
    assert has_area(square(factor, {"scale": 1e-12}, TURN, {"scale": 1e12 * SIDE})) == there
    assert (
        has_area(square(1.0, {"scale": [factor * SIDE * 1e9, SIDE * 1e9, 1]}, {"scale": 1e-9}, TURN)) == there
    )
    radius = factor * SIDE / math.sqrt(math.pi)
    assert has_area(shape(type="disc", radius=radius, normal=[3, -1, 2])) == there
    assert has_area(shape(type="sphere", radius=radius)) == there
    assert has_area(triangle(factor * SIDE * 2**0.25, [1, 1, 0], transform=[TURN])) == there


def test_what_is_pressed_flat_keeps_the_area_of_the_side_that_is_pressed() -> None:
    press = {"scale": [1, 1, 1e-12]}
    tiny = 1e-15
    assert has_area(shape(type="disc", radius=tiny, normal=[0, 0, 1], transform=[press]))
    assert not has_area(shape(type="disc", radius=tiny, normal=[1, 0, 0], transform=[press]))


def test_one_keyframe_with_an_area_is_enough() -> None:
    def at(time: float, scale: float) -> dict[str, Any]:
        return {"time": time, "transform": {"scale": scale}}

    small = 1e-12
    for scales, there in (((small, small), False), ((small, 1), True)):
        keyframes = [at(time, scale) for time, scale in enumerate(scales)]
        assert has_area(shape(type="sphere", radius=1e-15, transform={"keyframes": keyframes})) == there


def test_a_mesh_has_an_area_where_one_triangle_has() -> None:
    assert not has_area(triangle(1.0, [2, 2, 2]))
    assert has_area(triangle(1.0, [2, 2, 2.001]))
    corners = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]
    assert has_area(shape(type="mesh", positions=corners, indices=[[0, 1, 2], [0, 0, 3], [0, 1, 3]]))
    assert not has_area(shape(type="mesh", positions=corners, indices=[[0, 1, 2], [0, 0, 3]]))
    assert has_area(shape(type="mesh", source={"file": "unknown.obj"}))


def test_a_shape_emits_where_it_has_a_radiance_and_an_area() -> None:
    assert emits(shape(type="sphere", emission={"radiance": [0, 0, 1]}))
    assert not emits(shape(type="sphere", emission={"radiance": 0}))
    assert not emits(shape(type="sphere", radius=1e-25, emission={"radiance": 1}))
    assert not emits(shape(type="sphere"))
    assert not emits(shape(type="plane"))
