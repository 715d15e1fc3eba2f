"""Boxes for the tree. Metres, in the tree's frame; computed in float64, stored in float32 with room for all
rounding."""

from __future__ import annotations

import itertools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.compile.transforms import Transform, matrix_at, poses_of

Points = NDArray[np.float64]
Boxes = NDArray[np.float32]

BOX_SLACK: Final = 2.0**-20
"""16 u of a box's largest coordinate; why is told at the macro of that name in cl/geometry/wide.cl."""
STEP_ANGLE: Final = 0.05
"""Radians of half-turn angle between two instants at which a moving box is looked at."""


def padded(lo: NDArray[Any], hi: NDArray[Any]) -> tuple[Boxes, Boxes]:
    """float32 boxes (n, 3) around the given ones, wider by BOX_SLACK."""
    lo32, hi32 = np.asarray(lo, np.float32), np.asarray(hi, np.float32)
    reach = np.maximum(np.abs(lo32), np.abs(hi32)).max(axis=1, initial=0.0)[:, None]
    pad = np.float32(BOX_SLACK) * reach
    return lo32 - pad, hi32 + pad


def _corners(lo: Points, hi: Points) -> Points:
    return np.array(
        [[(lo, hi)[k][axis] for axis, k in enumerate(ks)] for ks in itertools.product((0, 1), repeat=3)]
    )


def transformed(lo: Points, hi: Points, matrix: Points) -> tuple[Points, Points]:
    """The box around a box (3,) after a 4x4 matrix."""
    center, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
    middle = matrix[:3, :3] @ center + matrix[:3, 3]
    extent = np.abs(matrix[:3, :3]) @ half
    return middle - extent, middle + extent


def _turn(a: Points, b: Points) -> float:
    """Angle of the rotation between two unit quaternions on the same side, radians."""
    return 4.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))


def swept(lo: Points, hi: Points, transform: Transform, first: float, last: float) -> tuple[Points, Points]:
    """The box around everything that a box (3,) passes through over [first, last] (absolute seconds).

    Between two looks at distance h (as a fraction of the segment) the path p = T + R S x of a corner stays
    within max |p''| h^2 / 8 of the chord; with the segment's angle w, |p''| <= w^2 |S x| + 2 w |S1 x - S0 x|.
    """
    poses = poses_of(transform, first, last)
    out_lo, out_hi = transformed(lo, hi, matrix_at(transform, first))
    for a, b in itertools.pairwise(poses):
        w = _turn(a.rotation, b.rotation)
        steps = max(1, math.ceil(w / STEP_ANGLE))
        corners = _corners(lo, hi)
        size = max(float(np.linalg.norm(corners @ s.T, axis=1).max()) for s in (a.stretch, b.stretch))
        change = float(np.linalg.norm(corners @ (b.stretch - a.stretch).T, axis=1).max())
        sagitta = (w * w * size + 2.0 * w * change) / (8.0 * steps * steps)
        for i in range(steps + 1):
            at_lo, at_hi = transformed(lo, hi, matrix_at(transform, a.time + (b.time - a.time) * i / steps))
            out_lo = np.minimum(out_lo, at_lo - sagitta)
            out_hi = np.maximum(out_hi, at_hi + sagitta)
    return out_lo, out_hi
