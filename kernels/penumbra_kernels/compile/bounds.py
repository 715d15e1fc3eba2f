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


def transformed(lo: Points, hi: Points, matrix: Points) -> tuple[Points, Points]:
    """The boxes around boxes (..., 3) after a 4x4 matrix."""
    center, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
    middle = center @ matrix[:3, :3].T + matrix[:3, 3]
    extent = half @ np.abs(matrix[:3, :3]).T
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


def _reach(lo: Points, hi: Points, linear: Points) -> Points:
    """(n,) distance from the origin of the farthest corner of boxes (n, 3) after a matrix (3, 3)."""
    corners = np.stack([np.where(pick, hi, lo) for pick in itertools.product((False, True), repeat=3)])
    return np.asarray(np.linalg.norm(corners @ linear.T, axis=-1).max(axis=0))


def _swept_between(
    a: Pose, b: Pose, lo: Points, hi: Points, first: Points, last: Points
) -> tuple[Points, Points]:
    """As `swept`, for the way from one pose to the next; inside out where it is not of the interval."""
    half_turn, span = _half_turn(a.rotation, b.rotation), b.time - a.time
    begin, end = (np.clip((t - a.time) / span, 0.0, 1.0) for t in (first, last))
    w, longest = 2.0 * half_turn, float((end - begin).max())
    steps = max(1, math.ceil(w * longest / STEP_ANGLE))
    t = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, steps + 1)
    linear, translation = _between(a, b, half_turn, t.reshape(-1))
    size = np.maximum(_reach(lo, hi, a.stretch), _reach(lo, hi, b.stretch))
    change = _reach(lo, hi, b.stretch - a.stretch)
    sagitta = (w * w * size + 2.0 * w * change) * (longest / steps) ** 2 / 8.0
    looks = (len(lo), steps + 1, 3)
    center, half = (np.repeat(x, steps + 1, axis=0)[..., None] for x in (0.5 * (lo + hi), 0.5 * (hi - lo)))
    middle = ((linear @ center)[..., 0] + translation).reshape(looks)
    extent = (np.abs(linear) @ half).reshape(looks) + sagitta[:, None, None]
    apart = ((last < a.time) | (first > b.time))[:, None]
    return (
        np.where(apart, np.inf, (middle - extent).min(axis=1)),
        np.where(apart, -np.inf, (middle + extent).max(axis=1)),
    )


def swept(lo: Points, hi: Points, transform: Transform, first: Points, last: Points) -> tuple[Points, Points]:
    """The boxes (n, 3) around all that boxes (n, 3) pass through, each from its first to its last time (n,), absolute
    seconds.

    Between two looks at distance h (as a fraction of the segment) the path p = T + R S x of a corner stays
    within max |p''| h^2 / 8 of the chord; with the segment's angle w, |p''| <= w^2 |S x| + 2 w |S1 x - S0 x|.
    """
    poses = poses_of(transform, float(first.min()), float(last.max()))
    boxes = [_swept_between(a, b, lo, hi, first, last) for a, b in itertools.pairwise(poses)]
    # Before its first pose and after its last it stands still.
    for pose, there in ((poses[0], first <= poses[0].time), (poses[-1], last >= poses[-1].time)):
        pose_lo, pose_hi = transformed(lo, hi, pose.matrix())
        where = there[:, None] | (len(poses) == 1)
        boxes.append((np.where(where, pose_lo, np.inf), np.where(where, pose_hi, -np.inf)))
    return np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
