"""Spheres near and far (hard cases 8, 9), against closed forms in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

RAYS = 100_000


@pytest.mark.parametrize(("distance", "wrong"), [(1e3, 1e-4), (1e4, 1e-3)])
def test_a_far_sphere_is_met_where_it_is(probe: Any, kit: Any, distance: float, wrong: float) -> None:
    rng = np.random.default_rng(1)
    geometry = kit.compiled([{"type": "sphere"}])
    impact = rng.uniform(0.9, 1.1, RAYS)
    angle = rng.uniform(0, 2 * np.pi, RAYS)
    targets = np.stack([impact * np.cos(angle), impact * np.sin(angle), 0 * angle], 1)
    rays = kit.rays(np.broadcast_to([0.0, 0.0, distance], targets.shape), targets - [0, 0, distance])
    rays[:, 3:6] = kit.unit(rays[:, 3:6])
    o, d = rays[:, :3].astype(np.float64), rays[:, 3:6].astype(np.float64)
    closest = np.linalg.norm(np.cross(o, d), axis=1) / np.linalg.norm(d, axis=1)
    answers = probe.trace(geometry, rays)
    assert np.mean((answers["kind"] == kit.SPHERE) != (closest <= 1.0)) <= wrong


def test_a_planet_underfoot_is_met_at_the_right_distance(probe: Any, kit: Any) -> None:
    """r = 1e6, eye 1 m above it, down to grazing: t within 4 ulp of the distance to the center, over the
    cosine."""
    rng = np.random.default_rng(2)
    r = 1e6
    geometry = kit.compiled([{"type": "sphere", "center": [0, -r - 1, 0], "radius": r}])
    down = np.exp(rng.uniform(np.log(2e-3), 0, RAYS))
    angle = rng.uniform(0, 2 * np.pi, RAYS)
    d = np.stack([np.cos(angle) * np.sqrt(1 - down**2), -down, np.sin(angle) * np.sqrt(1 - down**2)], 1)
    rays = kit.rays(np.zeros((RAYS, 3)), d)
    d = rays[:, 3:6].astype(np.float64)
    a, b, c = np.einsum("ij,ij->i", d, d), d[:, 1] * (r + 1), (r + 1) ** 2 - r**2
    truth = (-b - np.sqrt(b * b - a * c)) / a
    answers = probe.trace(geometry, rays)
    assert (answers["kind"] == kit.SPHERE).all()
    cosine = np.sqrt(b * b - a * c) / r
    assert (np.abs(answers["t"] - truth) * cosine <= 4 * 2.0**-24 * r).all()
    assert (answers["ng"][:, 1] > 0.99).all()
    # towards a low sun: no shadow of the ground itself
    sun = kit.unit([1.0, 0.01, 0.0])
    assert not probe.trace(geometry, kit.rays(answers["origin"], np.broadcast_to(sun, d.shape)))[
        "occluded"
    ].any()
