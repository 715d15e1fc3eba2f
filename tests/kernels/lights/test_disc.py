"""Disc lights: irradiance in closed form, uniform area, agreement of sample and hit."""

from __future__ import annotations

import math

import numpy as np
import pytest


def disc(bench, center, u, v, **more):
    return bench.scene([bench.light("disc", position=center, direction=u, axis_v=v, **more)])


@pytest.mark.parametrize("distance", [0.5, 1.0, 10.0, 1e3])
def test_irradiance_on_the_axis(bench, distance: float) -> None:
    """E = pi L r^2 / (r^2 + d^2)."""
    scene = disc(bench, (0, 0, distance), (0, 1.5, 0), (1.5, 0, 0))
    s = bench.sample(scene, (0, 0, 0), bench.grid(512))
    assert np.mean(s.wi[:, 2].astype(np.float64) / s.pdf) == pytest.approx(
        math.pi * 2.25 / (2.25 + distance**2), rel=2e-5
    )


def test_irradiance_beside_the_axis(bench) -> None:
    """Parallel disc of radius r at height h, lit point at distance a from its axis (a point's form factor):
    E = pi / 2 [1 - (h^2 + a^2 - r^2) / sqrt((h^2 + a^2 + r^2)^2 - 4 a^2 r^2)]."""
    a, h, r = 1.3, 0.8, 1.0
    s = bench.sample(disc(bench, (a, 0, h), (0, r, 0), (r, 0, 0)), (0, 0, 0), bench.grid(512))
    z = h * h + a * a + r * r
    exact = math.pi / 2 * (1 - (z - 2 * r * r) / math.sqrt(z * z - 4 * a * a * r * r))
    assert np.mean(s.wi[:, 2].astype(np.float64) / s.pdf) == pytest.approx(exact, rel=2e-5)


def test_points_are_uniform_over_an_ellipse(bench) -> None:
    u, v = np.array([0.0, 2.0, 0.0]), np.array([0.7, 0.3, 0.0])
    count, bins = 400_000, 24
    s = bench.sample(disc(bench, (0, 0, 2), u, v), (0.5, 0, 0), bench.uniform(count, 31))
    assert len(s.pdf) == count
    a, b = np.linalg.lstsq(np.stack([u, v], 1), (s.p - np.float32([0, 0, 2])).T, rcond=None)[0]
    r2 = a * a + b * b
    assert r2.max() <= 1 + 1e-5
    turn = np.arctan2(b, a) / (2 * math.pi) + 0.5
    cells = np.clip((np.stack([r2, turn], 1) * bins).astype(int), 0, bins - 1)
    counts = np.bincount(cells[:, 0] * bins + cells[:, 1], minlength=bins * bins)
    assert bench.chi2_pvalue(counts, np.full(bins * bins, count / bins**2)) > 1e-6


def test_density_per_solid_angle_is_r2_over_area_cos(bench) -> None:
    scene = disc(bench, (0.2, 0.1, 2), (0, 2, 0), (0.7, 0.3, 0))
    s = bench.sample(scene, (0.5, 0, 0), bench.uniform(10_000, 32))
    area = math.pi * 1.4
    r = np.linalg.norm(s.p.astype(np.float64) - [0.5, 0, 0], axis=1)
    assert np.allclose(s.pdf, r**2 / (area * s.wi[:, 2].astype(np.float64)), rtol=3e-6)
    assert np.array_equal(bench.hit_pdf(scene, (0.5, 0, 0), s.wi, s.distance, s.n), s.pdf)


def test_one_side_two_sides(bench) -> None:
    u = bench.uniform(500, 33)
    one = disc(bench, (0, 0, 1), (1, 0, 0), (0, 1, 0))  # faces +z, away from the origin
    both = disc(bench, (0, 0, 1), (1, 0, 0), (0, 1, 0), flags=1)
    assert len(bench.sample(one, (0, 0, 0), u).pdf) == 0
    assert len(bench.sample(one, (0, 0, 1), u).pdf) == 0  # in its plane
    assert len(bench.sample(one, (0, 0, 2), u).pdf) == 500
    s = bench.sample(both, (0, 0, 0), u)
    assert len(s.pdf) == 500
    assert np.allclose(s.n, (0, 0, -1))
