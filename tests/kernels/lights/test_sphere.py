"""Sphere lights: irradiance in closed form down to a ratio of 1e-6, cone sampling, inside, by area."""

from __future__ import annotations

import math

import numpy as np
import pytest


def sphere(bench, center=(0.0, 0.0, 0.0), radius=1.0, **more):
    return bench.scene([bench.light("sphere", position=center, inner=radius, **more)])


@pytest.mark.parametrize("ratio", [0.999, 0.3, 1e-3, 1e-5])
def test_directions_are_uniform_in_the_cone(bench, ratio: float) -> None:
    w = np.array([2.0, -1.0, 2.0]) / 3
    center = w / ratio
    count, bins = 400_000, 32
    s = bench.sample(sphere(bench, center), (0, 0, 0), bench.uniform(count, 21))
    assert len(s.pdf) == count
    # in the plane through the center: 1 - cos = tan^2 / (sqrt(1 + tan^2) (sqrt(1 + tan^2) + 1))
    n = s.n.astype(np.float64)
    d = s.wi.astype(np.float64)
    side = d - (d @ w)[:, None] * w
    tan2 = np.sum(side**2, axis=1) / (d @ w) ** 2
    root = np.sqrt(1 + tan2)
    fraction = tan2 / (root * (root + 1)) * (1 + math.sqrt(1 - ratio**2)) / ratio**2
    if ratio < 1e-4:  # the direction itself has too few digits: use the normal, whose sine is the scaled one
        fraction = np.sum((n - (n @ w)[:, None] * w) ** 2, axis=1)
    a = np.cross(w, [0, 1, 0]) / np.linalg.norm(np.cross(w, [0, 1, 0]))
    azimuth = np.arctan2(n @ np.cross(w, a), n @ a) / (2 * math.pi) + 0.5
    cells = np.clip((np.stack([fraction, azimuth], 1) * bins).astype(int), 0, bins - 1)
    counts = np.bincount(cells[:, 0] * bins + cells[:, 1], minlength=bins * bins)
    assert bench.chi2_pvalue(counts, np.full(bins * bins, count / bins**2)) > 1e-6
    exact = 2 * math.pi * ratio**2 / (1 + math.sqrt(1 - ratio**2))
    assert np.allclose(s.pdf, 1 / exact, rtol=2e-6)


@pytest.mark.parametrize("ratio", [0.999, 0.3, 1e-3])
def test_target_lies_on_the_near_side_in_that_direction(bench, ratio: float) -> None:
    center = np.array([0.3, -0.2, 1.0])
    center *= 5.0 / ratio / np.linalg.norm(center)
    s = bench.sample(sphere(bench, center, 5.0), (0, 0, 0), bench.uniform(20_000, 22))
    p, n, wi = (x.astype(np.float64) for x in (s.p, s.n, s.wi))
    assert np.allclose(np.linalg.norm(n, axis=1), 1, atol=1e-6)
    assert np.all(
        np.abs(np.linalg.norm(p - np.float32(center), axis=1) - 5.0) <= np.linalg.norm(s.p_error, axis=1)
    )
    assert np.all(np.sum(n * wi, axis=1) < 1e-3)
    aimed = p / np.linalg.norm(p, axis=1, keepdims=True)
    slack = 4e-7 + np.linalg.norm(s.p_error, axis=1) / s.distance
    assert np.all(np.linalg.norm(aimed - wi, axis=1) <= slack)


def test_inside_a_two_sided_sphere_every_direction_meets_it(bench) -> None:
    scene = sphere(bench, (0.5, 0.0, 0.0), 2.0, flags=1)
    count, bins = 400_000, 24
    s = bench.sample(scene, (0.0, 1.0, 0.3), bench.uniform(count, 23))
    assert len(s.pdf) == count
    assert np.allclose(s.pdf, 1 / (4 * math.pi), rtol=1e-6)
    assert np.allclose(np.linalg.norm(s.p - np.float32([0.5, 0, 0]), axis=1), 2.0, rtol=1e-5)
    assert np.all(np.sum(s.n * s.wi, axis=1) < 0)
    height = np.clip(((s.wi[:, 1] + 1) / 2 * bins).astype(int), 0, bins - 1)
    turn = np.clip(
        ((np.arctan2(s.wi[:, 0], s.wi[:, 2]) / (2 * math.pi) + 0.5) * bins).astype(int), 0, bins - 1
    )
    counts = np.bincount(height * bins + turn, minlength=bins * bins)
    assert bench.chi2_pvalue(counts, np.full(bins * bins, count / bins**2)) > 1e-6


def test_inside_a_one_sided_sphere_it_is_dark(bench, area_bench) -> None:
    u = bench.uniform(1000, 24)
    d = np.tile([[0.0, 1.0, 0.0]], (1000, 1))
    for which in (bench, area_bench):
        scene = sphere(which)
        assert len(which.sample(scene, (0, 0.5, 0), u).pdf) == 0
        assert not which.hit_pdf(scene, (0, 0.5, 0), d, np.full(1000, 0.5), d).any()


@pytest.mark.parametrize("flags", [0, 1])
def test_area_sampling_gives_the_same_irradiance(area_bench, flags: int) -> None:
    """Of the near side alone, also where the far side is sampled and emits as well."""
    scene = sphere(area_bench, (0.0, 3.0, 0.0), 1.0, flags=flags)
    grid = area_bench.grid(512)
    s = area_bench.sample(scene, (0, 0, 0), grid)
    values = np.zeros(len(grid))
    front = np.sum(s.n * s.wi, axis=1) < 0
    assert front.all()
    outside = np.sum((s.p - np.float32([0, 3, 0])) * s.wi, axis=1) < 0
    values[s.index] = np.where(outside, s.wi[:, 1].astype(np.float64) / s.pdf, 0)
    assert values.mean() == pytest.approx(math.pi / 9, rel=1e-3)
    ng = (s.p - np.float32([0, 3, 0])) / np.linalg.norm(s.p - np.float32([0, 3, 0]), axis=1, keepdims=True)
    hit = area_bench.hit_pdf(scene, (0, 0, 0), s.wi, s.distance, ng)
    steep = np.abs(np.sum(s.n * s.wi, axis=1)) > 0.05
    assert np.allclose(hit[steep], s.pdf[steep], rtol=1e-4)


@pytest.mark.parametrize("ratio", [0.999, 0.3, 1e-3])
def test_a_samples_density_is_that_of_hitting_it(bench, ratio: float) -> None:
    scene = sphere(bench, (0.0, 1.0 / ratio, 0.0))
    s = bench.sample(scene, (0, 0, 0), bench.uniform(1000, 25))
    assert np.array_equal(bench.hit_pdf(scene, (0, 0, 0), s.wi, s.distance, s.n), s.pdf)


def test_at_the_surface_and_the_center_everything_is_finite(bench, area_bench) -> None:
    for which in (bench, area_bench):
        for flags in (0, 1):
            for p in [(0, 0, 0), (0, 1, 0), (0, 1 + 1e-7, 0), (0, 1 - 1e-7, 0), (0.6, 0.8, 0)]:
                s = which.sample(sphere(which, flags=flags), p, which.uniform(2000, 26))
                assert np.all(np.isfinite(s.pdf))
                assert np.all(np.isfinite(s.wi))
                assert np.all(np.isfinite(s.n))
