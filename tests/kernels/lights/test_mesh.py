"""Mesh lights: form factors at any distance, the choice of triangles, agreement of sample and hit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from penumbra_kernels.hardcases.benches.lights import mesh_light
from penumbra_kernels.hardcases.lights import TRIANGLE as TRIANGLE_AT_1
from penumbra_kernels.hardcases.lights import triangle_irradiance
from penumbra_kernels.layout import CONSTANTS

ORIGIN = (0.0, 0.0, 0.0)


def barycentric(points, corners):
    system = np.concatenate([corners.T, np.ones((1, 3))])
    right = np.concatenate([points.T.astype(np.float64), np.ones((1, len(points)))])
    return np.linalg.lstsq(system, right, rcond=None)[0].T


def solid_angle(a, b, c):
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    volume = np.abs(np.sum(a * np.cross(b - a, c - a), axis=-1))
    dots = np.sum(a * b, -1) * lc + np.sum(b * c, -1) * la + np.sum(c * a, -1) * lb
    return 2 * np.arctan2(volume, la * lb * lc + dots)


TRIANGLES = {
    "near": TRIANGLE_AT_1 * [3, 1, 3],
    "over the point": TRIANGLE_AT_1 * [3, 0.01, 3],
    "from the side": TRIANGLE_AT_1 * [1, 0.05, 1] + [1, 0, 0],
    "edge-on": TRIANGLE_AT_1 * [1, 0.004, 1] + [0.8, 0, 0],
    "needle": np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.001], [1.0, 1.0, -0.001]]),
}


@pytest.mark.parametrize("name", TRIANGLES)
def test_samples_are_uniform_in_solid_angle(bench, name: str) -> None:
    """chi^2 over n^2 congruent parts of the triangle, whose solid angles are known."""
    corners = TRIANGLES[name].astype(np.float32).astype(np.float64)
    scene, _ = mesh_light(bench, corners, [[0, 1, 2]], flags=1)
    count, n = 500_000, 20
    s = bench.sample(scene, ORIGIN, bench.uniform(count, 41))
    assert len(s.pdf) == count
    w = barycentric(s.p, corners)
    assert w.min() > -2e-4
    w = np.clip(w, 0, None)
    w /= w.sum(axis=1, keepdims=True)
    i, j = (np.minimum((w[:, k] * n).astype(int), n - 1) for k in (1, 2))
    upper = (w[:, 1] * n - i) + (w[:, 2] * n - j) > 1
    counts = np.bincount((i * n + j) * 2 + upper, minlength=2 * n * n)
    a, e1, e2 = corners[0], (corners[1] - corners[0]) / n, (corners[2] - corners[0]) / n
    gi, gj = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    p = a + gi[:, None] * e1 + gj[:, None] * e2
    lower_angle, upper_angle = solid_angle(p, p + e1, p + e2), solid_angle(p + e1 + e2, p + e1, p + e2)
    halves = [np.where(gi + gj < n, lower_angle, 0), np.where(gi + gj < n - 1, upper_angle, 0)]
    expected = np.stack(halves, 1).ravel()
    # rounding puts a few points of the slanted side into a part beyond it
    beyond = counts[expected == 0].sum()
    assert beyond <= 1e-3 * count
    counts[expected == 0] = 0
    assert bench.chi2_pvalue(counts, expected / expected.sum() * counts.sum()) > 1e-6
    assert np.allclose(s.pdf, 1 / expected.sum(), rtol=2e-5)


def icosahedron():
    g = (1 + math.sqrt(5)) / 2
    v = [(s * a, t * b, 0.0) for a, b in [(1, g)] for s in (-1, 1) for t in (-1, 1)]
    v = np.array([np.roll(p, k) for k in range(3) for p in v])
    faces = [
        (a, b, c)
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if all(abs(np.linalg.norm(v[x] - v[y]) - 2) < 1e-9 for x, y in ((a, b), (b, c), (a, c)))
    ]
    outside = [(a, b, c) if np.linalg.det(v[[a, b, c]]) > 0 else (a, c, b) for a, b, c in faces]
    return v, np.array(outside)


@pytest.mark.parametrize("density", ["solid angle", "area"])
def test_icosahedron_against_the_sum_of_its_visible_faces(bench, area_bench, density: str) -> None:
    which = bench if density == "solid angle" else area_bench
    v, faces = icosahedron()
    assert len(faces) == 20
    v = (v * [1.0, 0.5, 2.0] + [1.0, 4.0, 0.5]).astype(np.float32).astype(np.float64)
    scene, _ = mesh_light(which, v, faces)
    s = which.sample(scene, ORIGIN, which.uniform(1_000_000, 42, 3))
    values = np.zeros(1_000_000)
    values[s.index] = s.wi[:, 1].astype(np.float64) / s.pdf
    up = np.array([0.0, 1.0, 0.0])
    front = [v[f] for f in faces if np.cross(v[f[1]] - v[f[0]], v[f[2]] - v[f[0]]) @ v[f[0]] < 0]
    exact = sum(triangle_irradiance(c, up) for c in front)
    error = values.std() / 1000
    assert abs(values.mean() - exact) < 5 * error
    assert error < 2e-3 * exact


def test_triangles_are_chosen_by_area(bench) -> None:
    v, faces = icosahedron()
    v = v * [1.0, 0.2, 3.0] + [0, 9, 0]
    scene, areas = mesh_light(bench, v, faces, flags=1)
    count = 300_000
    s = bench.sample(scene, ORIGIN, bench.uniform(count, 43, 3))
    assert len(s.pdf) == count
    normals = np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    height = np.abs(np.einsum("nfk,fk->nf", s.p[:, None] - v[faces[:, 0]][None], normals))
    counts = np.bincount(height.argmin(axis=1), minlength=20)
    assert bench.chi2_pvalue(counts, areas / areas.sum() * count) > 1e-6


@pytest.mark.parametrize("name", TRIANGLES)
@pytest.mark.parametrize("density", ["solid angle", "area"])
def test_a_samples_density_is_that_of_hitting_it(bench, area_bench, name: str, density: str) -> None:
    which = bench if density == "solid angle" else area_bench
    other = [[-3, 2, -1], [-3, 2, 1], [-2, 2, 0]]
    v = np.concatenate([other, TRIANGLES[name]])
    scene, _ = mesh_light(which, v, [[0, 1, 2], [3, 4, 5]], flags=1)
    u = which.uniform(5000, 44, 3)
    u[:, 2] = 1 - 2.0**-24
    s = which.sample(scene, ORIGIN, u)
    assert len(s.pdf) == 5000
    hit = which.hit_pdf(scene, ORIGIN, s.wi, s.distance, s.n, primitive=2)
    assert np.array_equal(hit, s.pdf)
    assert not which.hit_pdf(scene, ORIGIN, s.wi, s.distance, s.n, primitive=0).any()
    assert not which.hit_pdf(scene, ORIGIN, s.wi, s.distance, s.n, primitive=3).any()


def test_mirrored_winding_emits_on_the_other_side(bench) -> None:
    u = bench.uniform(100, 45)
    for flip in (0, CONSTANTS["SHAPE_FLIP"]):
        scenes = [mesh_light(bench, TRIANGLE_AT_1, [face], flip)[0] for face in ([0, 1, 2], [0, 2, 1])]
        given = [len(bench.sample(scene, ORIGIN, u).pdf) for scene in scenes]
        assert sorted(given) == [0, 100]
        facing = [0, 1, 2] if given[0] else [0, 2, 1]
        normal = np.cross(*(TRIANGLE_AT_1[facing[i]] - TRIANGLE_AT_1[facing[0]] for i in (1, 2)))
        assert (normal[1] < 0) == (flip == 0)


def test_degenerate_triangles_are_never_chosen(bench) -> None:
    v = np.concatenate([TRIANGLE_AT_1, [[0, 1, 0], [0, 1, 0], [0, 1, 0]]])
    scene, _ = mesh_light(bench, v, [[3, 4, 5], [0, 1, 2], [3, 3, 4]], flags=1)
    s = bench.sample(scene, ORIGIN, bench.uniform(2000, 46, 3))
    assert len(s.pdf) == 2000
    assert np.all(np.isfinite(s.pdf))
