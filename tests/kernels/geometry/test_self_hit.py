"""Rays that leave a surface neither meet it again nor pass through what it closes off (hard cases 4, 5, 6,
7)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.hardcases.leaving import leaving

RAYS = 30_000


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
    again = probe.trace(geometry, leaving(hit, rng, 1.0, times[met]))
    same = (again["kind"] == hit["kind"]) & (again["primitive"] == hit["primitive"])
    assert not same[hit["kind"] != kit.TRIANGLE].any()
    assert not (same | ((again["kind"] == kit.TRIANGLE) & (hit["kind"] == kit.TRIANGLE))).any()
