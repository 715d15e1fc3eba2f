"""Point, spot and directional lights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from penumbra_kernels.compile.transforms import keyframes_of, matrix_at
from penumbra_scene.lights import PointLight


def test_point_light_falls_with_the_square_of_the_distance(bench) -> None:
    scene = bench.scene([bench.light("point", position=(1, 2, 3), radiance=(8, 4, 2))])
    points = np.array([[1, 2, 1], [1, 6, 3], [-2, 2, 7]])
    s = bench.sample(scene, points, np.zeros((3, 2)))
    assert s.delta.all()
    assert np.allclose(s.radiance, np.array([8, 4, 2]) / np.array([[4], [16], [25]]), rtol=1e-6)
    assert np.allclose(s.wi, [[0, 0, 1], [0, -1, 0], [0.6, 0, -0.8]], atol=1e-6)
    assert np.allclose(s.distance, [2, 4, 5])
    assert np.array_equal(s.pdf, np.ones(3))
    assert np.array_equal(s.p, np.tile(np.float32([1, 2, 3]), (3, 1)))
    assert not s.n.any()
    assert not s.p_error.any()


def test_at_the_point_light_itself_nothing_arrives(bench) -> None:
    scene = bench.scene([bench.light("point", position=(1, 2, 3))])
    assert len(bench.sample(scene, (1, 2, 3), np.zeros((1, 2))).pdf) == 0


def spot(bench, inner: float, outer: float):
    return bench.scene(
        [
            bench.light(
                "spot",
                position=(0, 5, 0),
                direction=(0, -1, 0),
                inner=1 - math.cos(inner),
                outer=1 - math.cos(outer),
            )
        ]
    )


def test_spot_is_full_inside_dark_outside_and_smooth_between(bench) -> None:
    inner, outer = math.radians(20), math.radians(40)
    angles = np.radians(np.linspace(0, 60, 200))
    points = np.stack([5 * np.tan(angles), np.zeros(200), np.zeros(200)], 1)
    s = bench.sample(spot(bench, inner, outer), points, np.zeros((200, 2)))
    got = np.zeros(200)
    got[s.index] = s.radiance[:, 0] * s.distance**2
    x = np.clip((np.cos(angles) - math.cos(outer)) / (math.cos(inner) - math.cos(outer)), 0, 1)
    assert np.allclose(got, x * x * (3 - 2 * x), atol=3e-6)


def test_spot_with_equal_angles_has_a_sharp_edge(bench) -> None:
    angle = math.radians(30)
    points = np.array([[5 * math.tan(angle * k), 0, 0] for k in (0.999, 1.001)])
    s = bench.sample(spot(bench, angle, angle), points, np.zeros((2, 2)))
    assert np.array_equal(s.index, [0])


def test_narrow_beam_keeps_its_profile(bench) -> None:
    """Outer angle 0.01 degrees: its cosine is 1 in float32."""
    outer = math.radians(0.01)
    part = np.array([0.0, 0.5, 0.9, 1.1])
    points = np.stack([5 * np.tan(outer * part), np.zeros(4), np.zeros(4)], 1)
    s = bench.sample(spot(bench, 0.0, outer), points, np.zeros((4, 2)))
    x = 1 - part[:3] ** 2
    assert np.array_equal(s.index, [0, 1, 2])
    assert np.allclose(s.radiance[:, 0] * s.distance**2, x * x * (3 - 2 * x), atol=1e-2)


def test_directional_light_is_everywhere_the_same(bench) -> None:
    scene = bench.scene([bench.light("directional", direction=(0.6, -0.8, 0), radiance=(3, 2, 1))])
    s = bench.sample(scene, np.array([[0, 0, 0], [1e6, 3, -2]]), np.zeros((2, 2)))
    assert np.allclose(s.wi, (-0.6, 0.8, 0))
    assert np.all(np.isinf(s.distance))
    assert np.array_equal(s.radiance, np.tile(np.float32([3, 2, 1]), (2, 1)))
    assert s.delta.all()


@pytest.mark.parametrize("kind", ["point", "spot", "directional"])
def test_motion_carries_the_light_along(bench, kind: str) -> None:
    """A quarter turn about +Z, and 2 m along x, over one second."""
    steps = [
        {"time": 0.0, "transform": [{"rotate": {"axis": [0, 0, 1], "angle": 0}}]},
        {"time": 1.0, "transform": [{"rotate": {"axis": [0, 0, 1], "angle": 90}}, {"translate": [2, 0, 0]}]},
    ]
    model = PointLight.model_validate({"type": "point", "transform": {"keyframes": steps}})
    transform = model.transform
    keys = keyframes_of(transform, 0.0, 0.0, 1.0)
    record = bench.light(
        kind,
        position=(1, 0, 0),
        direction=(1, 0, 0),
        inner=0.1,
        outer=0.2,
        first_keyframe=1,
        keyframe_count=len(keys),
    )
    scene = bench.scene([record], keyframes=np.concatenate([keys[:1], keys]))
    for time in (0.0, 0.25, 0.5, 1.0):
        m = matrix_at(transform, time)
        position, axis = (m @ [1, 0, 0, 1])[:3], m[:3, 0]
        p = position + 3 * axis
        s = bench.sample(scene, p, np.zeros((1, 2)), time=time)
        assert len(s.pdf) == 1
        assert np.allclose(s.wi, -axis, atol=1e-6)
        if kind != "directional":
            assert np.allclose(s.p, position, atol=1e-6)
            assert np.allclose(s.radiance, 1 / 9, rtol=1e-5)
