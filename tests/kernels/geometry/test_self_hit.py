"""Rays that leave a surface neither meet it again nor pass through what it closes off (hard cases 4, 5, 6,
7)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

RAYS = 30_000


def _leaving(answers: Any, rng: np.random.Generator, kit: Any, side: float, time: Any = 0.0) -> Any:
    """Rays from the answers' spawned origins into the hemisphere of side * ng, grazing ones among them."""
    normals = answers["ng"].astype(np.float64) * side
    d = kit.directions(rng, len(answers))
    d[::2] -= 0.999 * np.einsum("ij,ij->i", d, normals)[::2, None] * normals[::2]  # near the tangent plane
    d = kit.unit(d)
    d *= np.where(np.einsum("ij,ij->i", d, normals) < 0, -1.0, 1.0)[:, None]
    return kit.rays(answers["origin"], d, time=time)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1.0, 1e2, 1e4])
@pytest.mark.parametrize("offset", [0.0, 1.0, 1e6])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_ray_never_meets_the_triangle_that_it_leaves(
    probe: Any, kit: Any, size: float, offset: float, side: float
) -> None:
    if size < 1e-6 * offset:
        pytest.skip("smaller than the spacing of floats there")
    rng = np.random.default_rng(5)
    met = 0
    for _ in range(8):
        corners = rng.normal(size=(3, 3)) * size + offset * kit.directions(rng, 1)
        meshes = kit.Meshes()
        geometry = kit.compiled([meshes.add(corners, [[0, 1, 2]])], meshes)
        weights = rng.dirichlet((1, 1, 1), RAYS // 8)
        targets = weights @ geometry.arrays["positions"].astype(np.float64)
        origins = targets + kit.directions(rng, len(targets)) * size * 3
        answers = probe.trace(geometry, kit.rays(origins, targets - origins), side)
        hit = answers[answers["kind"] == kit.TRIANGLE]
        met += len(hit)
        again = probe.trace(geometry, _leaving(hit, rng, kit, side))
        assert np.count_nonzero(again["kind"] != kit.NONE) == 0
        assert not again["occluded"].any()
    assert met > RAYS // 4


@pytest.mark.parametrize("thin", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_a_ray_never_meets_the_needle_that_it_leaves(
    probe: Any, kit: Any, thin: float, offset: float
) -> None:
    """Rays along a needle: edge functions whose relative error is not small let thousands of them meet it
    again."""
    rng = np.random.default_rng(11)
    for _ in range(3):
        along, across = kit.directions(rng, 2)
        start = rng.normal(size=3) + offset * kit.directions(rng, 1)[0]
        corners = np.array([start, start + along, start + 0.4 * along + thin * across])
        meshes = kit.Meshes()
        geometry = kit.compiled([meshes.add(corners, [[0, 1, 2]])], meshes)
        targets = rng.dirichlet((1, 1, 1), RAYS // 2) @ geometry.arrays["positions"].astype(np.float64)
        origins = targets + kit.directions(rng, len(targets)) * 2
        answers = probe.trace(geometry, kit.rays(origins, targets - origins), 1.0)
        hit = answers[answers["kind"] == kit.TRIANGLE]
        assert len(hit) > RAYS // 10
        leaving = _leaving(hit, rng, kit, 1.0)
        d = 1e-3 * kit.directions(rng, len(hit)) + along * rng.choice([-1, 1], len(hit))[:, None]
        d *= np.where(np.einsum("ij,ij->i", d, hit["ng"]) < 0, -1.0, 1.0)[:, None]
        leaving[::3, 3:6] = d[::3]
        assert np.count_nonzero(probe.trace(geometry, leaving)["kind"] != kit.NONE) == 0


@pytest.mark.parametrize("shape", ["sphere", "disc", "plane"])
@pytest.mark.parametrize("size", [1e-6, 1e-2, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("offset", [0.0, 10.0, 1e4])
def test_a_ray_never_meets_the_round_primitive_that_it_leaves(
    probe: Any, kit: Any, shape: str, size: float, offset: float
) -> None:
    if size < 1e-6 * offset:
        pytest.skip("smaller than the spacing of floats there")
    rng = np.random.default_rng(6)
    center = [float(x) for x in kit.directions(rng, 1)[0] * offset]
    model: dict[str, Any] = {
        "sphere": {"type": "sphere", "center": center, "radius": size},
        "disc": {"type": "disc", "center": center, "normal": [0.3, 0.5, 0.7], "radius": size},
        "plane": {"type": "plane", "point": center, "normal": [0.3, 0.5, 0.7]},
    }[shape]
    geometry = kit.compiled([model])
    targets = np.asarray(center) + rng.normal(size=(RAYS, 3)) * size * 0.3
    origins = targets + kit.directions(rng, RAYS) * 4 * size
    answers = probe.trace(geometry, kit.rays(origins, targets - origins), 1.0)
    hit = answers[answers["kind"] != kit.NONE]
    assert len(hit) > RAYS // 10
    again = probe.trace(geometry, _leaving(hit, rng, kit, 1.0))
    assert np.count_nonzero(again["kind"] != kit.NONE) == 0


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3])
def test_a_ray_into_a_sphere_comes_out_at_the_far_side(probe: Any, kit: Any, size: float) -> None:
    """Started from the surface inwards, at any angle: the chord is 2 r cos (hard case 10)."""
    rng = np.random.default_rng(7)
    geometry = kit.compiled([{"type": "sphere", "radius": size}])
    origins = kit.directions(rng, RAYS) * 4 * size
    answers = probe.trace(
        geometry, kit.rays(origins, -origins + rng.normal(size=(RAYS, 3)) * 0.3 * size), -1.0
    )
    hit = answers[answers["kind"] != kit.NONE]
    inside = _leaving(hit, rng, kit, -1.0)
    again = probe.trace(geometry, inside)
    assert (again["kind"] == kit.SPHERE).all()
    o, d = inside[:, :3].astype(np.float64), inside[:, 3:6].astype(np.float64)
    a, b = np.einsum("ij,ij->i", d, d), np.einsum("ij,ij->i", o, d)
    chord = (-b + np.sqrt(b * b - a * (np.einsum("ij,ij->i", o, o) - float(np.float32(size)) ** 2))) / a
    assert (np.abs(again["t"] / chord - 1) < 1e-5).all()


INSTANCE_SCALES = [1e-3, 1.0, 1e3]


@pytest.mark.parametrize("scale", INSTANCE_SCALES)
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_a_ray_never_meets_the_instance_that_it_leaves(
    probe: Any, kit: Any, scale: float, moving: bool, offset: float
) -> None:
    rng = np.random.default_rng(8)
    steps = [
        {"scale": [scale, 0.3 * scale, -2 * scale]},
        {"rotate": {"axis": [1, 2, 3], "angle": 50}},
        {"translate": [offset, -offset, 2 * offset]},
    ]
    turned = [*steps[:2], {"rotate": {"axis": [3, 1, 0], "angle": 40}}, *steps[2:]]
    keyframes = {"keyframes": [{"time": 0, "transform": steps}, {"time": 1, "transform": turned}]}
    prototype = [
        {"type": "quad", "transform": {"translate": [0, 0, 2]}},
        {"type": "sphere", "center": [3, 1, 2], "radius": 0.7},
        {"type": "disc", "center": [-3, 0, 1], "normal": [1, 1, 0]},
    ]
    instance = {"type": "instance", "prototype": "p", "transform": keyframes if moving else steps}
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 1}}
    geometry = kit.compiled([instance], prototypes={"p": prototype}, camera=camera)
    times = rng.random(RAYS).astype(np.float32)
    center = np.array([offset, -offset, 2 * offset])
    targets = center + rng.normal(size=(RAYS, 3)) * 3 * scale
    origins = center + kit.directions(rng, RAYS) * 20 * scale
    answers = probe.trace(geometry, kit.rays(origins, targets - origins, time=times), 1.0)
    met = answers["kind"] != kit.NONE
    hit = answers[met]
    assert len(hit) > RAYS // 50
    again = probe.trace(geometry, _leaving(hit, rng, kit, 1.0, times[met]))
    same = (again["kind"] == hit["kind"]) & (again["primitive"] == hit["primitive"])
    assert not same[hit["kind"] != kit.TRIANGLE].any()
    assert not (same | ((again["kind"] == kit.TRIANGLE) & (hit["kind"] == kit.TRIANGLE))).any()


@pytest.mark.parametrize(("size", "offset"), [(1.0, 0.0), (1e-6, 0.0), (1.0, 1e3), (1.0, 1e4), (1e4, 1.0)])
@pytest.mark.parametrize("far", [0.0, 1e6, 1e9])
def test_nothing_leaks_out_of_a_closed_box(
    probe: Any, kit: Any, size: float, offset: float, far: float
) -> None:
    """Bounces from wall to wall inside a box: every ray meets a wall, whatever the box's size and place.

    offset: from the anchor; far: how far the camera and the box stand from the scene's origin.
    """
    if size < far * 2.0**-50:
        pytest.skip("smaller than the spacing of doubles there")
    rng = np.random.default_rng(9)
    corners = (
        np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64) * size + offset
    )
    faces = []
    for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)):
        faces += [[a, c, b], [a, d, c]]  # normals inwards
    meshes = kit.Meshes()
    geometry = kit.compiled([meshes.add(corners + far, faces)], meshes, anchor=(far, far, far))
    start = (rng.uniform(0.2, 0.8, (RAYS, 3)) * size + offset).astype(np.float32)
    d = kit.directions(rng, RAYS)
    inside = 0.5 * (corners[0] + corners[-1])
    for _ in range(4):
        answers = probe.trace(geometry, kit.rays(start, d), 1.0)
        assert np.count_nonzero(answers["kind"] == kit.NONE) == 0
        towards = np.where(np.einsum("ij,ij->i", answers["ng"], inside - answers["p"]) < 0, -1.0, 1.0)
        assert (towards == towards[0]).all()
        start, d = answers["origin"], kit.directions(rng, RAYS)
        n = answers["ng"].astype(np.float64)
        d *= np.where(np.einsum("ij,ij->i", d, n) < 0, -1.0, 1.0)[:, None]


def test_both_of_two_nested_spheres_are_met(probe: Any, kit: Any) -> None:
    """r = 1 and 1 + 4e-5: the ray that enters the outer one meets the inner one next (hard case 7)."""
    rng = np.random.default_rng(10)
    gap = 4e-5
    geometry = kit.compiled([{"type": "sphere", "radius": 1.0}, {"type": "sphere", "radius": 1.0 + gap}])
    origins = kit.directions(rng, 100_000) * 3
    answers = probe.trace(geometry, kit.rays(origins, -origins), -1.0)
    assert (answers["primitive"] == 1).all()
    again = probe.trace(geometry, kit.rays(answers["origin"], -origins))
    assert (again["primitive"] == 0).all()
