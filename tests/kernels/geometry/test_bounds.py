"""Boxes of moving things hold everything that they pass through, and little more."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.compile.bounds import swept
from penumbra_kernels.compile.transforms import matrix_at
from penumbra_scene.shapes import Sphere


@pytest.mark.parametrize("seed", range(20))
def test_a_swept_box_holds_every_instant(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def steps() -> list[Any]:
        return [
            {"scale": [float(x) for x in rng.uniform(0.5, 2, 3) * rng.choice([-1, 1], 3)]},
            {
                "rotate": {
                    "axis": [float(x) for x in rng.normal(size=3)],
                    "angle": float(rng.uniform(-180, 180)),
                }
            },
            {"scale": [float(x) for x in rng.uniform(0.5, 2, 3)]},
            {"translate": [float(x) for x in rng.normal(size=3)]},
        ]

    keyframes = [{"time": float(t), "transform": steps()} for t in (0.0, 0.7, 1.5)]
    transform = Sphere.model_validate({"type": "sphere", "transform": {"keyframes": keyframes}}).transform
    lo = rng.uniform(-2, 0, 3)
    hi = lo + rng.uniform(0, 3, 3)
    parts = np.linspace(0.2, 1.2, 4)
    boxes = swept(np.tile(lo, (3, 1)), np.tile(hi, (3, 1)), transform, parts[:-1], parts[1:])
    corners = np.array(
        [[(lo, hi)[i][0], (lo, hi)[j][1], (lo, hi)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    for box_lo, box_hi, (first, last) in zip(*boxes, itertools.pairwise(parts), strict=True):
        matrices = [matrix_at(transform, t) for t in np.linspace(first, last, 700)]
        points = np.concatenate([corners @ m[:3, :3].T + m[:3, 3] for m in matrices])
        assert (points >= box_lo - 1e-9).all()
        assert (points <= box_hi + 1e-9).all()
        assert (box_hi - box_lo <= 1.02 * np.ptp(points, axis=0) + 0.02).all()
