"""Quad lights against closed forms: form factors, solid angles, chi^2, at any distance and tilt."""

from __future__ import annotations

import numpy as np
import pytest

UNIT = {"position": (-0.5, 0.0, -0.5), "direction": (1.0, 0.0, 0.0), "axis_v": (0.0, 0.0, 1.0)}
"""A unit square about the origin that emits downwards."""


def quad(bench, o, u, v, **more):
    return bench.scene([bench.light("quad", position=o, direction=u, axis_v=v, **more)])


def on_quad(samples, o, u, v):
    """(a, b) of the samples' points."""
    matrix = np.stack([u, v], 1).astype(np.float64)
    return np.linalg.lstsq(matrix, (samples.p - np.asarray(o)).T.astype(np.float64), rcond=None)[0].T


SHAPES = {
    "near rectangle": ((-0.5, 1.0, -0.2), (1.5, 0.0, 0.0), (0.0, 0.0, 0.8)),
    "rectangle over the point": ((-0.5, 0.02, -0.2), (1.5, 0.0, 0.0), (0.0, 0.0, 0.8)),
    "rectangle from the side": ((0.3, 0.05, 0.2), (1.5, 0.0, 0.0), (0.0, 0.0, 0.8)),
    "edge-on rectangle": ((0.3, 0.003, 0.2), (1.5, 0.0, 0.0), (0.0, 0.0, 0.8)),
    "neon tube": ((-2.0, 0.7, 0.3), (4.0, 0.0, 0.0), (0.0, 0.0, 0.004)),
    "tilted rectangle": ((-0.4, 1.0, 0.3), (0.6, 0.3, 0.5), (0.5, 0.6, -0.96)),
    "parallelogram": ((-0.5, 0.6, -0.2), (1.0, 0.1, 0.3), (0.4, 0.2, 0.9)),
    "edge-on parallelogram": ((-0.5, 0.004, -0.2), (1.0, 0.0, 0.3), (0.4, 0.0, 0.9)),
    "far rectangle": ((-0.5, 40.0, -0.2), (1.5, 0.0, 0.0), (0.0, 0.0, 0.8)),
}


def towards_origin(o, u, v):
    """The same quad with its edges in the order that makes it emit towards the origin."""
    o, u, v = (np.asarray(a, np.float64) for a in (o, u, v))
    return (o, u, v) if np.cross(u, v) @ o < 0 else (o, v, u)


def bin_solid_angles(o, u, v, bins: int) -> np.ndarray:
    """(bins, bins) solid angles, from the origin, of the cells of (a, b), in float64: two triangles each."""
    step = np.arange(bins + 1) / bins
    grid = o + step[:, None, None] * u + step[None, :, None] * v
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return triangle_solid_angle(a, b, c) + triangle_solid_angle(a, c, d)


def triangle_solid_angle(a, b, c):
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    dot = lambda x, y: np.sum(x * y, axis=-1)  # noqa: E731
    volume = np.abs(dot(a, np.cross(b - a, c - a)))
    return 2 * np.arctan2(volume, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)


@pytest.mark.parametrize("name", SHAPES)
def test_samples_are_uniform_in_solid_angle(bench, name: str) -> None:
    o, u, v = towards_origin(*SHAPES[name])
    count, bins = 1_000_000, 24
    s = bench.sample(quad(bench, o, u, v), (0.0, 0.0, 0.0), bench.uniform(count, 11))
    ab = on_quad(s, o, u, v)
    assert len(s.pdf) == count
    assert ab.min() > -1e-5
    assert ab.max() < 1 + 1e-5
    cells = np.minimum((np.clip(ab, 0, 1) * bins).astype(int), bins - 1)
    counts = np.bincount(cells[:, 0] * bins + cells[:, 1], minlength=bins * bins).reshape(bins, bins)
    angles = bin_solid_angles(o, u, v, bins)
    exact = angles if name != "far rectangle" else np.full((bins, bins), 1.0)  # by area there
    if name == "far rectangle":
        weights = np.bincount(cells[:, 0] * bins + cells[:, 1], weights=1 / s.pdf.astype(float))
        assert weights.sum() / count == pytest.approx(angles.sum(), rel=1e-4)
    assert bench.chi2_pvalue(counts, exact / exact.sum() * count) > 1e-6


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("density", ["solid angle", "area"])
def test_density_integrates_to_one_over_the_quad(bench, area_bench, name: str, density: str) -> None:
    o, u, v = towards_origin(*SHAPES[name])
    which = bench if density == "solid angle" else area_bench
    side = 2048 if name.startswith("edge-on") else 1024
    ab = (which.grid(side)).astype(np.float64)
    d = o + ab[:, :1] * u + ab[:, 1:] * v
    r = np.linalg.norm(d, axis=1)
    n = np.cross(u, v)
    pdf = which.hit_pdf(quad(which, o, u, v), (0, 0, 0), d / r[:, None], r, np.broadcast_to(n, d.shape))
    solid = np.abs(d @ n) / r**3
    assert np.mean(pdf * solid) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("density", ["solid angle", "area"])
def test_a_samples_density_is_that_of_hitting_it(bench, area_bench, name: str, density: str) -> None:
    o, u, v = towards_origin(*SHAPES[name])
    which = bench if density == "solid angle" else area_bench
    scene = quad(which, o, u, v)
    s = which.sample(scene, (0, 0, 0), which.uniform(20_000, 5))
    hit = which.hit_pdf(scene, (0, 0, 0), s.wi, s.distance, s.n)
    assert np.array_equal(hit, s.pdf)


def test_area_sampling_is_the_lectures_formula(area_bench) -> None:
    """One sample's estimate is L A cos / r^2."""
    o, u, v = SHAPES["parallelogram"]
    o, u, v = towards_origin(o, u, v)
    scene = quad(area_bench, o, u, v, radiance=(3.0, 2.0, 1.0))
    numbers = area_bench.uniform(50_000, 6)
    s = area_bench.sample(scene, (0, 0, 0), numbers)
    assert np.allclose(on_quad(s, o, u, v), numbers[s.index], atol=1e-5)
    r2 = np.sum(s.p.astype(np.float64) ** 2, axis=1)
    n = np.cross(u, v)
    area = np.linalg.norm(n)
    cosine = np.abs(s.p.astype(np.float64) @ n) / area / np.sqrt(r2)
    estimate = s.radiance[:, 0].astype(np.float64) / s.pdf
    assert np.allclose(estimate, 3.0 * area * cosine / r2, rtol=2e-6)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e4])
def test_scale_changes_nothing(bench, size: float) -> None:
    o, u, v = towards_origin(*SHAPES["tilted rectangle"])
    numbers = bench.uniform(10_000, 7)
    one = bench.sample(quad(bench, o, u, v), (0, 0, 0), numbers)
    other = bench.sample(quad(bench, o * size, u * size, v * size), (0, 0, 0), numbers)
    assert np.allclose(other.pdf, one.pdf, rtol=1e-5)
    assert np.allclose(other.wi, one.wi, atol=2e-5)


def test_behind_and_edge_on_nothing_arrives(bench, area_bench) -> None:
    u = bench.uniform(1000, 8)
    up = np.tile([[0.0, -1.0, 0.0]], (1000, 1))
    for which in (bench, area_bench):
        scene = which.scene([which.light("quad", **UNIT)])
        for p in [(0, 1, 0), (0, 0, 0), (0.2, 0, 0.2), (3, 0, 0), (-0.5, 0, -0.5)]:
            assert len(which.sample(scene, p, u).pdf) == 0
            assert not which.hit_pdf(scene, p, up, np.ones(1000), up).any()


def test_two_sided_emits_both_ways(bench) -> None:
    scene = bench.scene([bench.light("quad", **UNIT, flags=1)])
    below = bench.sample(scene, (0.1, -0.7, 0.2), bench.uniform(1000, 10))
    above = bench.sample(scene, (0.1, 0.7, 0.2), bench.uniform(1000, 10))
    assert np.allclose(below.pdf, above.pdf, rtol=1e-5)
    assert np.allclose(below.n, (0, -1, 0))
    assert np.allclose(above.n, (0, 1, 0))


def test_emitted_radiance_leaves_the_front_alone(bench) -> None:
    directions = np.array([[0, -1, 0], [0.6, -0.8, 0], [0, 1, 0], [1, 0, 0]])
    normal = np.tile([[0.0, -1.0, 0.0]], (4, 1))
    one = bench.scene([bench.light("quad", **UNIT, radiance=(1, 2, 3))])
    two = bench.scene([bench.light("quad", **UNIT, radiance=(1, 2, 3), flags=1)])
    assert np.array_equal(
        bench.emitted(one, directions, normal), [[1, 2, 3], [1, 2, 3], [0, 0, 0], [0, 0, 0]]
    )
    assert np.array_equal(bench.emitted(two, directions, normal), np.tile([1, 2, 3], (4, 1)))


def test_error_bound_covers_the_distance_to_the_plane(bench) -> None:
    """The sampled point lies on the exact quad to within p_error, far from the origin too."""
    rng = np.random.default_rng(12)
    for _ in range(20):
        o, u, v = rng.normal(size=3) * 1e3, rng.normal(size=3), rng.normal(size=3)
        o, u, v = (np.float64(np.float32(a)) for a in (o, u, v))
        n = np.cross(u, v)
        s = bench.sample(quad(bench, o, u, v), o + u + n, bench.uniform(500, 13))
        assert len(s.pdf)
        distance = np.abs((s.p.astype(np.float64) - o) @ n)
        assert np.all(distance <= s.p_error.astype(np.float64) @ np.abs(n))
