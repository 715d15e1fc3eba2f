"""Lights that instances carry: still, moving, stretched, mirrored. They are what the same light is when its
geometry is transformed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from penumbra_kernels.compile.transforms import keyframes_of, matrix_at, matrix_of
from penumbra_kernels.layout import INSTANCE, SHAPE, TRIANGLE
from penumbra_scene.lights import PointLight


def steps(axis, angle, scale, translate) -> list[dict]:
    return [{"rotate": {"axis": axis, "angle": angle}}, {"scale": scale}, {"translate": translate}]


STILL = {
    "similar": steps([1, 2, 3], 50, 1.7, [0.3, 3, 1]),
    "mirrored": steps([1, 0, 3], 20, [1, -1, 1], [0.3, 3, 1]),
    "stretched": steps([1, 2, 0], 30, [2, 0.4, 1], [0, 3, 0]),
}
MOVING = [
    {"time": 0.0, "transform": [{"translate": [0, 3, 0]}]},
    {"time": 1.0, "transform": steps([0.3, 0.2, 1], 80, 2, [2, 3, 1])},
]
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 6.0, -2.0], [-2.0, 2.5, 1.5], [40.0, 3.0, 0.0], [0.0, 3.0, -9.0]])

QUAD = {"position": (-0.5, -0.4, 0.1), "direction": (1.0, 0.2, 0.0), "axis_v": (-0.1, 0.9, 0.3)}
DISC = {"position": (0.1, 0.2, 0.1), "direction": (0.6, 0.2, 0.0), "axis_v": (-0.1, 0.9, 0.3)}


def transform_of(value):
    return PointLight.model_validate({"type": "point", "transform": value}).transform


def instance_of(matrix=None, keyframe_count: int = 0) -> np.ndarray:
    record = np.zeros(2, INSTANCE)
    if matrix is not None:
        record["world_from_object"][1] = matrix[:3]
        record["object_from_world"][1] = np.linalg.inv(matrix)[:3]
    record["first_keyframe"][1], record["keyframe_count"][1] = 1, keyframe_count
    return record


def by_hand(kind: str, values: dict, m: np.ndarray) -> dict:
    """The light's geometry in the world; edges swap where the matrix mirrors: outside stays outside."""
    a, b = (m[:3, :3] @ np.array(values[k]) for k in ("direction", "axis_v"))
    if np.linalg.det(m[:3, :3]) < 0:
        a, b = b, a
    return {"position": m[:3, :3] @ np.array(values["position"]) + m[:3, 3], "direction": a, "axis_v": b}


def agree(bench, carried, world, time: float, ng=None) -> None:
    given = 0
    for p in POINTS:
        u = bench.uniform(500, 51, 3)
        a, b = bench.sample(carried, p, u, time=time), bench.sample(world, p, u, time=time)
        assert np.array_equal(a.index, b.index)
        if not len(a.pdf):
            continue
        given += 1
        assert np.allclose(a.pdf, b.pdf, rtol=3e-5)
        assert np.allclose(a.n, b.n, atol=1e-5)
        # Edges swapped on the way give another point of the same distribution.
        assert np.all(np.abs(np.sum((a.p - b.p[0]) * b.n[0], axis=1)) < 1e-5 * (1 + np.abs(b.p).max()))
        hit = bench.hit_pdf(carried, p, a.wi, a.distance, a.n, time=time)
        assert np.allclose(hit, a.pdf, rtol=1e-5)
    assert given >= 1


@pytest.mark.parametrize(("kind", "values"), [("quad", QUAD), ("disc", DISC)])
@pytest.mark.parametrize("name", STILL)
def test_flat_lights_stand_where_the_instance_puts_them(bench, area_bench, kind, values, name) -> None:
    m = matrix_of(transform_of(STILL[name]))
    for which in (bench, area_bench):
        carried = which.scene([which.light(kind, **values, instance=1, flags=0)], instances=instance_of(m))
        agree(which, carried, which.scene([which.light(kind, **by_hand(kind, values, m))]), 0.0)


@pytest.mark.parametrize(("kind", "values"), [("quad", QUAD), ("disc", DISC)])
@pytest.mark.parametrize("time", [0.0, 0.3, 0.75, 1.0, 2.0])
def test_flat_lights_move_along(bench, area_bench, kind, values, time) -> None:
    transform = transform_of({"keyframes": MOVING})
    keys = keyframes_of(transform, 0.0, 0.0, 1.0)
    for which in (bench, area_bench):
        carried = which.scene(
            [which.light(kind, **values, instance=1)],
            instances=instance_of(keyframe_count=len(keys)),
            keyframes=np.concatenate([keys[:1], keys]),
        )
        world = which.scene([which.light(kind, **by_hand(kind, values, matrix_at(transform, time)))])
        agree(which, carried, world, time)


@pytest.mark.parametrize("time", [0.0, 0.3, 1.0])
def test_meshes_move_along_with_their_area(bench, time) -> None:
    transform = transform_of({"keyframes": MOVING})
    keys = keyframes_of(transform, 0.0, 0.0, 1.0)
    v = np.array([[-0.4, 0.1, -0.3], [0.1, 0.0, 0.6], [0.7, -0.1, -0.2]])
    m = matrix_at(transform, time)
    triangles = np.zeros(1, TRIANGLE)
    triangles["vertex"] = [0, 1, 2]
    cdf = np.array([0, 1], np.float32)
    common = {"triangles": triangles, "shapes": np.zeros(1, SHAPE), "emitter_cdf": cdf}
    record = {"triangle_count": 1, "shape": 0, "flags": 1}
    carried = bench.scene(
        [bench.light("mesh", **record, instance=1)],
        instances=instance_of(keyframe_count=len(keys)),
        keyframes=np.concatenate([keys[:1], keys]),
        positions=v.astype(np.float32),
        **common,
    )
    moved = (v @ m[:3, :3].T + m[:3, 3]).astype(np.float32)
    world = bench.scene([bench.light("mesh", **record)], positions=moved, **common)
    agree(bench, carried, world, time)


@pytest.mark.parametrize("time", [0.0, 0.6, 1.0])
def test_spheres_move_and_grow(bench, area_bench, time) -> None:
    transform = transform_of({"keyframes": MOVING})
    keys = keyframes_of(transform, 0.0, 0.0, 1.0)
    m = matrix_at(transform, time)
    center = np.array([0.2, 0.1, -0.3])
    scale = np.linalg.norm(m[:3, 0])
    for which in (bench, area_bench):
        carried = which.scene(
            [which.light("sphere", position=center, inner=0.5, instance=1)],
            instances=instance_of(keyframe_count=len(keys)),
            keyframes=np.concatenate([keys[:1], keys]),
        )
        world_center = m[:3, :3] @ center + m[:3, 3]
        p = np.array([1.0, 0.5, 0.2])
        count = 4000
        s = which.sample(carried, p, which.uniform(count, 52), time=time)
        d = np.linalg.norm(world_center - p)
        r = 0.5 * scale
        assert np.allclose(np.linalg.norm(s.p - world_center, axis=1), r, rtol=1e-5)
        assert np.allclose(np.cross(s.n, s.p - world_center), 0, atol=2e-5)
        if which is bench:
            one_minus_cos = (r / d) ** 2 / (1 + math.sqrt(1 - (r / d) ** 2))
            assert np.allclose(s.pdf, 1 / (2 * math.pi * one_minus_cos), rtol=2e-5)
        else:
            cosine = -np.sum(s.n * s.wi, axis=1)
            wide = cosine > 0.01
            exact = s.distance**2 / (4 * math.pi * r * r * cosine)
            assert np.allclose(s.pdf[wide], exact[wide], rtol=1e-4)
        hit = which.hit_pdf(carried, p, s.wi, s.distance, s.n, time=time)
        assert np.allclose(hit, s.pdf, rtol=2e-4 if which is area_bench else 1e-5)


def ellipsoid_rays(m: np.ndarray, center: np.ndarray, radius: float, p: np.ndarray, d: np.ndarray):
    """Whether rays from p along d meet the ellipsoid, in float64."""
    inverse = np.linalg.inv(m)
    o = (inverse @ [*p, 1])[:3] - center
    w = d @ inverse[:3, :3].T
    b = w @ o
    return (b * b - np.sum(w * w, axis=1) * (o @ o - radius**2) >= 0) & (b < 0)


def test_ellipsoids_are_sampled_over_all_that_is_seen_of_them(bench, area_bench) -> None:
    """Irradiance and solid angle against float64 quadrature; every sample meets the ellipsoid."""
    m = matrix_of(transform_of(STILL["stretched"]))
    center, radius, p = np.array([0.1, 0.0, 0.2]), 0.8, np.array([0.3, 0.4, -0.5])
    n = 1200
    z, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n * 2 * np.pi)
    y, s = z.ravel(), np.sqrt(1 - z.ravel() ** 2)
    d = np.stack([s * np.cos(phi.ravel()), y, s * np.sin(phi.ravel())], 1)
    seen = ellipsoid_rays(m, center, radius, p, d)
    solid, irradiance = seen.mean() * 2 * np.pi, np.mean(seen * y) * 2 * np.pi
    for which in (bench, area_bench):
        scene = which.scene(
            [which.light("sphere", position=center, inner=radius, instance=1)], instances=instance_of(m)
        )
        count = 400_000
        got = which.sample(scene, p, which.uniform(count, 53))
        weight, cosine = np.zeros(count), np.zeros(count)
        weight[got.index] = 1 / got.pdf.astype(np.float64)
        cosine[got.index] = got.wi[:, 1]
        for values, exact in ((weight, solid), (weight * cosine, irradiance)):
            assert abs(values.mean() - exact) < 5 * values.std() / math.sqrt(count) + 1e-3 * exact
        on_it = np.linalg.inv(m) @ np.concatenate([got.p.T.astype(np.float64), np.ones((1, len(got.pdf)))])
        assert np.allclose(np.linalg.norm(on_it[:3].T - center, axis=1), radius, rtol=1e-5)
        assert np.all(ellipsoid_rays(m, center, radius * 1.0001, p, got.wi.astype(np.float64)))
        hit = which.hit_pdf(scene, p, got.wi[:1000], got.distance[:1000], got.n[:1000])
        steep = -np.sum(got.n[:1000] * got.wi[:1000], axis=1) > 0.02
        assert np.allclose(hit[steep], got.pdf[:1000][steep], rtol=1e-4)


def test_ellipsoid_density_follows_the_samples(bench) -> None:
    """chi^2 of directions, binned about the axis to the center, against float64 quadrature of the density."""
    m = matrix_of(transform_of(STILL["stretched"]))
    center, radius, p = np.array([0.1, 0.0, 0.2]), 0.8, np.array([0.3, 0.4, -0.5])
    record = bench.light("sphere", position=center, inner=radius, instance=1)
    scene = bench.scene([record], instances=instance_of(m))
    axis = (m @ [*center, 1])[:3] - p
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, [1, 0, 0])
    side /= np.linalg.norm(side)
    up = np.cross(side, axis)
    count, bins, fine = 400_000, 20, 40
    s = bench.sample(scene, p, bench.uniform(count, 54))
    reach = 1.0
    at = [s.wi @ e / (s.wi @ axis) / reach for e in (side, up)]
    cells = [np.clip(((x + 1) / 2 * bins).astype(int), 0, bins - 1) for x in at]
    counts = np.bincount(cells[0] * bins + cells[1], minlength=bins * bins)
    t = ((np.arange(bins * fine) + 0.5) / (bins * fine) * 2 - 1) * reach
    a, b = (x.ravel() for x in np.meshgrid(t, t, indexing="ij"))
    d = axis + a[:, None] * side + b[:, None] * up
    solid = np.sum(d * d, axis=1) ** -1.5 * (2 * reach / (bins * fine)) ** 2
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    seen = ellipsoid_rays(m, center, radius, p, d)
    pdf = bench.hit_pdf(scene, p, d, np.ones(len(d)), d)
    density = (seen * pdf * solid).reshape(bins, fine, bins, fine).sum(axis=(1, 3)).ravel()
    assert density.sum() == pytest.approx(1.0, rel=1e-3)
    whole = seen.reshape(bins, fine, bins, fine).all(axis=(1, 3)).ravel()  # at the rim quadrature is coarse
    rest = np.append(counts[whole], counts[~whole].sum())
    expected = np.append(density[whole] * count, count - density[whole].sum() * count)
    assert bench.chi2_pvalue(rest, expected) > 1e-6
