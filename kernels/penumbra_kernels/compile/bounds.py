"""Boxes for the tree. Metres, in the tree's frame; computed in float64, stored in float32 with room for all
rounding."""

from __future__ import annotations

import itertools
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.compile.transforms import Pose, Transform, poses_of

Points = NDArray[np.float64]
Boxes = NDArray[np.float32]

BOX_SLACK: Final = 2.0**-20
"""16 u of a box's largest coordinate; why is told at the macro of that name in cl/geometry/wide.cl."""
STEP_ANGLE: Final = 0.05
"""Radians that a box turns between two instants at which it is looked at."""


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


def _half_turn(a: Points, b: Points) -> float:
    """Half the angle of the rotation between two unit quaternions on the same side, radians."""
    return 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))


def _rotations(q: Points) -> Points:
    """(n, 3, 3) of quaternions (n, 4), x y z w, of any length."""
    x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _between(a: Pose, b: Pose, half_turn: float, t: Points) -> tuple[Points, Points]:
    """Linear parts (n, 3, 3) and translations (n, 3) at fractions t (n,) of the way from one pose to the next."""
    if half_turn > 0.0:
        wa, wb = np.sin((1.0 - t) * half_turn), np.sin(t * half_turn)
    else:
        wa, wb = 1.0 - t, t
    linear = _rotations(wa[:, None] * a.rotation + wb[:, None] * b.rotation)
    stretch = (1.0 - t)[:, None, None] * a.stretch + t[:, None, None] * b.stretch
    return linear @ stretch, (1.0 - t)[:, None] * a.translation + t[:, None] * b.translation


def swept(lo: Points, hi: Points, transform: Transform, first: float, last: float) -> tuple[Points, Points]:
    """The box around everything that a box (3,) passes through over [first, last] (absolute seconds).

    Between two looks at distance h (as a fraction of the segment) the path p = T + R S x of a corner stays
    within max |p''| h^2 / 8 of the chord; with the segment's angle w, |p''| <= w^2 |S x| + 2 w |S1 x - S0 x|.
    """
    poses = poses_of(transform, first, last)
    out_lo, out_hi = transformed(lo, hi, poses[0].matrix())
    corners = _corners(lo, hi)
    center, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
    for a, b in itertools.pairwise(poses):
        half_turn = _half_turn(a.rotation, b.rotation)
        w = 2.0 * half_turn
        steps = max(1, math.ceil(w / STEP_ANGLE))
        size = max(float(np.linalg.norm(corners @ s.T, axis=1).max()) for s in (a.stretch, b.stretch))
        change = float(np.linalg.norm(corners @ (b.stretch - a.stretch).T, axis=1).max())
        sagitta = (w * w * size + 2.0 * w * change) / (8.0 * steps * steps)
        linear, translation = _between(a, b, half_turn, np.linspace(0.0, 1.0, steps + 1))
        middle, extent = linear @ center + translation, np.abs(linear) @ half + sagitta
        out_lo = np.minimum(out_lo, (middle - extent).min(axis=0))
        out_hi = np.maximum(out_hi, (middle + extent).max(axis=0))
    return out_lo, out_hi
