"""Transforms on the host, in float64: steps to matrices, keyframes to what cl/geometry/motion.cl reads.

Matrices are world-from-local, 4x4, applied to column vectors; metres, seconds. A motion is kept as
translation, rotation (quaternion x y z w) and stretch (symmetric; mirrors make it negative): matrix = T R S.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.transforms import Keyframes, LookAt, Matrix, Rotate, Scale, Step, Translate

from penumbra_kernels.layout import KEYFRAME

Array = NDArray[np.float64]
Transform: TypeAlias = tuple[Step, ...] | Keyframes

ORIGIN: Final = np.zeros(3)

HALF_TURN_DOT: Final = 1e-9
"""Below it quaternions are half a turn apart as far as rounding tells: both arcs are shortest."""


def _cos_sin_degrees(angle: float) -> tuple[float, float]:
    """cos and sin of an angle in degrees, exact at multiples of 90: right angles keep boxes on their axes."""
    quarter, rest = divmod(angle, 90.0)
    c, s = math.cos(math.radians(rest)), math.sin(math.radians(rest))
    return ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]


def _rotation(axis: Sequence[float], angle: float) -> Array:
    """3x3, counter-clockwise seen from the axis' tip (Rodrigues)."""
    a = np.asarray(axis, np.float64)
    a = a / np.max(np.abs(a))
    a = a / np.linalg.norm(a)
    c, s = _cos_sin_degrees(angle)
    cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    return c * np.eye(3) + s * cross + (1.0 - c) * np.outer(a, a)


def _look_at(origin: Sequence[float], target: Sequence[float], up: Sequence[float]) -> Array:
    """4x4, world from a frame at `origin` that looks along its -Z at `target`, Y towards `up`."""
    back = np.asarray(origin, np.float64) - np.asarray(target, np.float64)
    back /= np.linalg.norm(back)
    right = np.cross(np.asarray(up, np.float64) / np.max(np.abs(up)), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, np.cross(back, right), back
    matrix[:3, 3] = origin
    return matrix


def _step_matrix(step: Step) -> Array:
    matrix = np.eye(4)
    if isinstance(step, Translate):
        matrix[:3, 3] = step.translate
    elif isinstance(step, Rotate):
        matrix[:3, :3] = _rotation(step.rotate.axis, step.rotate.angle)
    elif isinstance(step, Scale):
        matrix[:3, :3] = np.diag(step.scale)
    elif isinstance(step, Matrix):
        matrix = np.array(step.matrix, np.float64)
    else:
        assert isinstance(step, LookAt)
        matrix = _look_at(step.look_at.origin, step.look_at.target, step.look_at.up)
    return matrix


def matrix_of(steps: Sequence[Step]) -> Array:
    """(4, 4) world-from-local matrix of a list of steps, which act on points in the order listed."""
    matrix = np.eye(4)
    for step in steps:
        matrix = _step_matrix(step) @ matrix
    return matrix


def shifted(matrix: Array, anchor: Array) -> Array:
    """The matrix with the anchor subtracted from its translation, before anything is rounded to float32."""
    out = matrix.copy()
    out[:3, 3] -= anchor
    return out


def polar(matrix: Array) -> tuple[Array, Array]:
    """(3, 3) orthogonal and symmetric factors, matrix = orthogonal symmetric (Higham 1986)."""
    u, sizes, vt = np.linalg.svd(matrix)
    return u @ vt, (vt.T * sizes) @ vt


def rotation_of(quaternion: Array) -> Array:
    """(3, 3) of a unit quaternion x y z w."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion x y z w, by whichever component is largest (Shepperd 1978). rotation: (3, 3), orthogonal."""
    m = np.asarray(rotation, np.float64)
    choice = int(np.argmax([m[0, 0], m[1, 1], m[2, 2], np.trace(m)]))
    if choice == 3:
        q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + np.trace(m)])
    else:
        i, j, k = choice, (choice + 1) % 3, (choice + 2) % 3
        q = np.empty(4)
        q[i] = 1.0 + m[i, i] - m[j, j] - m[k, k]
        q[j], q[k], q[3] = m[j, i] + m[i, j], m[k, i] + m[i, k], m[k, j] - m[j, k]
    return np.asarray(q / np.linalg.norm(q))


@dataclass(frozen=True)
class Pose:
    """A motion's state at one time: matrix = T R S."""

    time: float
    translation: Array
    rotation: Array
    """Unit quaternion x y z w."""
    stretch: Array
    """Symmetric 3x3."""

    def matrix(self) -> Array:
        out = np.eye(4)
        out[:3, :3] = rotation_of(self.rotation) @ self.stretch
        out[:3, 3] = self.translation
        return out


def pose_of(time: float, matrix: Array) -> Pose:
    """The pose of a 4x4 matrix, by polar decomposition (Shoemake and Duff 1992); where it mirrors, both factors change
    sign."""
    rotation, stretch = polar(matrix[:3, :3])
    if np.linalg.det(rotation) < 0.0:
        rotation, stretch = -rotation, -stretch
    quaternion = quaternion_of(rotation)
    return Pose(time, matrix[:3, 3].copy(), quaternion, 0.5 * (stretch + stretch.T))


def _turned(steps: Sequence[Step]) -> Array:
    """Sum of the steps' rotation vectors (degrees): which way their author means a half turn to go."""
    total = np.zeros(3)
    for step in steps:
        if isinstance(step, Rotate):
            axis = np.asarray(step.rotate.axis, np.float64)
            total += step.rotate.angle * axis / np.linalg.norm(axis)
    return total


def _aligned(previous: Pose, pose: Pose, meant: Array) -> Pose:
    """The pose with that sign of its quaternion that makes the arc from `previous` the shorter one.

    Half a turn has two shortest arcs: then the way in which the rotate steps' angles grow decides, or, where
    they do not tell, the largest component of the axis turns positive.
    """
    dot = float(previous.rotation @ pose.rotation)
    flip = dot < 0.0
    if abs(dot) < HALF_TURN_DOT:
        axis = _product_axis(pose.rotation, previous.rotation)
        along = float(axis @ meant)
        if along == 0.0:
            along = float(axis[np.argmax(np.abs(axis))])
        flip = along < 0.0
    if not flip:
        return pose
    return Pose(pose.time, pose.translation, -pose.rotation, pose.stretch)


def _product_axis(a: Array, b: Array) -> Array:
    """Vector part of a times the conjugate of b."""
    return np.asarray(b[3] * a[:3] - a[3] * b[:3] - np.cross(a[:3], b[:3]))


def _half_angle(a: Array, b: Array) -> float:
    """Angle between two unit quaternions, accurate at 0 and pi (Kahan 2006, section 12)."""
    return 2.0 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))


def _slerp(a: Array, b: Array, t: float) -> Array:
    angle = _half_angle(a, b)
    if angle == 0.0:
        return a
    q = (math.sin((1.0 - t) * angle) * a + math.sin(t * angle) * b) / math.sin(angle)
    return np.asarray(q / np.linalg.norm(q))


def _between(a: Pose, b: Pose, time: float) -> Pose:
    """The pose at a time in [a.time, b.time]; the ends themselves exactly."""
    if time == a.time:
        return a
    if time == b.time:
        return b
    t = (time - a.time) / (b.time - a.time)
    return Pose(
        time,
        (1.0 - t) * a.translation + t * b.translation,
        _slerp(a.rotation, b.rotation, t),
        a.stretch if np.array_equal(a.stretch, b.stretch) else (1.0 - t) * a.stretch + t * b.stretch,
    )


def slides(poses: Sequence[Pose]) -> bool:
    """Whether the translation is all that changes from pose to pose."""
    first = poses[0]
    return all(
        np.array_equal(pose.rotation, first.rotation) and np.array_equal(pose.stretch, first.stretch)
        for pose in poses
    )


def _needed(transform: Keyframes, first: float, last: float) -> slice:
    """The keyframes that say where the thing is at times in [first, last]."""
    times = [k.time for k in transform.keyframes]
    begin = max((i for i, t in enumerate(times) if t <= first), default=0)
    end = min((i for i, t in enumerate(times) if t >= last), default=len(times) - 1)
    return slice(begin, max(begin, end) + 1)


def poses_of(transform: Transform, first: float, last: float) -> list[Pose]:
    """The motion over [first, last] (absolute seconds): a pose at each end and at the keyframes inside.

    Part of a slerp is the slerp of its ends, so cutting changes nothing. Signs of the quaternions follow the
    shorter arc. One pose where nothing moves.
    """
    if not isinstance(transform, Keyframes):
        return [pose_of(first, matrix_of(transform))]
    needed = transform.keyframes[_needed(transform, first, last)]
    matrices = [matrix_of(k.transform) for k in needed]
    if first == last or all(np.array_equal(m, matrices[0]) for m in matrices):
        return [pose_of(first, matrix_at(transform, first))]
    poses = [pose_of(needed[0].time, matrices[0])]
    for before, keyframe, matrix in zip(needed, needed[1:], matrices[1:], strict=False):
        meant = _turned(keyframe.transform) - _turned(before.transform)
        poses.append(_aligned(poses[-1], pose_of(keyframe.time, matrix), meant))
    return _cut(poses, first, last)


def _cut(poses: list[Pose], first: float, last: float) -> list[Pose]:
    """Poses over [first, last]; a motion that starts later or ends earlier stands still before and after."""
    out = []
    for a, b in itertools.pairwise(poses):
        if a.time >= first:
            out.append(a)
        elif b.time > first:
            out.append(_between(a, b, first))
        if b.time > last > a.time:
            out.append(_between(a, b, last))
    if poses[-1].time <= last:
        out.append(poses[-1])
    return out


def matrix_at(transform: Transform, t: float) -> Array:
    """(4, 4) matrix at an absolute time in seconds; at a keyframe's own time exactly that of its steps."""
    if not isinstance(transform, Keyframes):
        return matrix_of(transform)
    needed = transform.keyframes[_needed(transform, t, t)]
    a, b = needed[0], needed[-1]
    if t <= a.time or a is b:
        return matrix_of(a.transform)
    if t >= b.time:
        return matrix_of(b.transform)
    start, end = matrix_of(a.transform), matrix_of(b.transform)
    if np.array_equal(start, end):
        return start
    first = pose_of(a.time, start)
    last = _aligned(first, pose_of(b.time, end), _turned(b.transform) - _turned(a.transform))
    return _between(first, last, t).matrix()


def is_similarity(matrix: Array) -> bool:
    """Whether a matrix only turns, mirrors, moves and scales all axes alike, up to float32's rounding."""
    m = matrix[:3, :3]
    gram = m.T @ m
    size = np.trace(gram) / 3.0
    return bool(np.abs(gram - size * np.eye(3)).max() <= 1e-6 * size)


def is_animated(transform: Transform) -> bool:
    """Whether the thing is not in the same place at all times."""
    if not isinstance(transform, Keyframes):
        return False
    first, *others = (matrix_of(key.transform) for key in transform.keyframes)
    return not all(np.array_equal(matrix, first) for matrix in others)


def moves(transform: Transform, time: float, shutter_open: float, shutter_close: float) -> bool:
    """Whether the thing moves while the shutter, [time + shutter_open, time + shutter_close], is open."""
    return len(poses_of(transform, time + shutter_open, time + shutter_close)) > 1


def keyframes_of(
    transform: Transform, time: float, shutter_open: float, shutter_close: float, anchor: Array = ORIGIN
) -> NDArray[Any] | None:
    """(n,) of KEYFRAME, n >= 2, for the shutter interval [time + shutter_open, time + shutter_close].

    None when nothing moves in it: then `matrix_at(transform, time + shutter_open)` holds.
    time: the frame's, seconds; stored times are relative to it.
    anchor: metres, subtracted from the translations in float64.
    """
    poses = poses_of(transform, time + shutter_open, time + shutter_close)
    return None if len(poses) < 2 else keyframe_records(poses, time, anchor)


def keyframe_records(poses: Sequence[Pose], time: float, anchor: Array = ORIGIN) -> NDArray[Any]:
    """(n,) of KEYFRAME of n poses at absolute times; see keyframes_of."""
    records = np.zeros(len(poses), KEYFRAME)
    for record, pose in zip(records, poses, strict=True):
        record["rotation"] = pose.rotation
        record["translation"] = pose.translation - anchor
        record["time"] = pose.time - time
        record["stretch"][:, :3] = pose.stretch
        record["stretch"][1, 3] = 1.0
    for record, a, b in zip(records, poses, poses[1:], strict=False):
        record["stretch"][:2, 3] = _slerp_constants(a.rotation, b.rotation)
    return records


def _slerp_constants(a: Array, b: Array) -> tuple[float, float]:
    """Square of the half angle to the next keyframe, and angle / sin(angle) (cl/geometry/motion.cl)."""
    angle = _half_angle(a, b)
    return angle * angle, 1.0 if angle == 0.0 else angle / math.sin(angle)
