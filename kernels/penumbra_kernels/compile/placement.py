"""Where a shape stands, still or moving, while the shutter is open. Metres, seconds; matrices float64,
4x4."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.shapes import Mesh, MeshKeyframe

from penumbra_kernels.compile import bounds
from penumbra_kernels.compile.transforms import (
    ORIGIN,
    Pose,
    Transform,
    keyframe_records,
    keyframes_of,
    matrix_at,
    pose_of,
    poses_of,
    shifted,
    slides,
)
from penumbra_kernels.layout import CONSTANTS, KEYFRAME

Matrix = NDArray[np.float64]
Point = NDArray[np.float64]


@dataclass(frozen=True)
class Shutter:
    """The frame's time and when its light is gathered, seconds."""

    time: float
    open: float
    close: float

    @property
    def first(self) -> float:
        return self.time + self.open

    @property
    def last(self) -> float:
        return self.time + self.close


@dataclass(frozen=True)
class Motion:
    """A transform over the shutter interval, relative to the anchor."""

    start: Matrix
    """At the shutter's opening."""
    transform: Transform | None = None
    """None: it stands still."""
    shutter: Shutter | None = None
    anchor: Point | None = None

    @staticmethod
    def of(transform: Transform, shutter: Shutter, anchor: Point = ORIGIN) -> Motion:
        start = shifted(matrix_at(transform, shutter.first), anchor)
        if (
            isinstance(transform, tuple)
            or keyframes_of(transform, shutter.time, shutter.open, shutter.close) is None
        ):
            return Motion(start)
        return Motion(start, transform, shutter, anchor)

    @property
    def moves(self) -> bool:
        return self.transform is not None

    @property
    def is_identity(self) -> bool:
        return not self.moves and np.array_equal(self.start, np.eye(4))

    def sweep(self, lo: Point, hi: Point, times: tuple[Point, Point] | None = None) -> tuple[Point, Point]:
        """The boxes around all that boxes (n, 3) pass through while the shutter is open, or from first to last times (n,),
        absolute seconds."""
        if self.transform is None or self.shutter is None or self.anchor is None:
            return bounds.transformed(lo, hi, self.start)
        first, last = times or (np.full(len(lo), t) for t in (self.shutter.first, self.shutter.last))
        lo, hi = bounds.swept(lo, hi, self.transform, first, last)
        return lo - self.anchor, hi - self.anchor

    def keyframes(self) -> NDArray[Any]:
        """(n,) of KEYFRAME; one where it stands still."""
        if self.transform is not None and self.shutter is not None and self.anchor is not None:
            s = self.shutter
            keys = keyframes_of(self.transform, s.time, s.open, s.close, self.anchor)
            assert keys is not None
            return keys
        return _still_keyframe(self.start)


def slide(outer: Motion, inner: Motion) -> NDArray[Any] | None:
    """(n,) of KEYFRAME of the two together, the inner one applied first, where one stands still and the other moves without
    turning or stretching; None otherwise."""
    if outer.moves == inner.moves:
        return None
    moving = outer if outer.moves else inner
    transform, shutter, anchor = moving.transform, moving.shutter, moving.anchor
    assert transform is not None
    assert shutter is not None
    assert anchor is not None
    poses = poses_of(transform, shutter.first, shutter.last)
    if not slides(poses):
        return None
    matrices = [shifted(pose.matrix(), anchor) for pose in poses]
    together = [m @ inner.start if outer.moves else outer.start @ m for m in matrices]
    first = pose_of(shutter.first, together[0])
    return keyframe_records(
        [
            Pose(pose.time, matrix[:3, 3], first.rotation, first.stretch)
            for pose, matrix in zip(poses, together, strict=True)
        ],
        shutter.time,
    )


def shutter_parts(shutter: Shutter, keys: NDArray[Any]) -> tuple[Point, Point]:
    """First and last times (n,), absolute seconds, of the MOTION_BOXES even parts of the time that keyframes span, as a
    device tells them apart by the times that these have in float32; the outer ones reach to the shutter's ends."""
    begin, end = (float(keys["time"][i]) for i in (0, -1))
    edges = np.linspace(begin, end, CONSTANTS["MOTION_BOXES"] + 1)
    # Keyframes' times and the ray's are rounded, and so is the quotient that picks the part.
    margin = 4.0 * float(np.spacing(np.float32(max(abs(begin), abs(end))))) + 1e-3 * (edges[1] - edges[0])
    first, last = edges[:-1] - margin, edges[1:] + margin
    first[0], last[-1] = min(first[0], shutter.open), max(last[-1], shutter.close)
    return shutter.time + first, shutter.time + last


def static_motion(matrix: Matrix) -> Motion:
    """Standing still under a matrix."""
    return Motion(matrix)


def _still_keyframe(matrix: Matrix) -> NDArray[Any]:
    from penumbra_scene.transforms import Matrix as MatrixStep

    rows = [tuple(float(x) for x in row) for row in matrix]
    pose = poses_of((MatrixStep.model_construct(matrix=tuple(rows)),), 0.0, 0.0)[0]  # type: ignore[arg-type]
    record = np.zeros(1, KEYFRAME)
    record["rotation"] = pose.rotation
    record["translation"] = pose.translation
    record["stretch"][0, :, :3] = pose.stretch
    record["stretch"][0, 1, 3] = 1.0
    return record


def form_keys(keys: tuple[MeshKeyframe, ...], first: float, last: float) -> tuple[MeshKeyframe, ...]:
    """The keyframes that say what form the mesh has at times in [first, last]."""
    times = [key.time for key in keys]
    begin = max(0, bisect_right(times, first) - 1)
    end = min(len(times) - 1, bisect_left(times, last))
    return keys[begin : max(begin, end) + 1]


def is_deformed(mesh: Mesh) -> bool:
    """Whether a mesh has not the same form at all times."""
    forms = mesh.deformation or ()
    return any(form.positions != forms[0].positions for form in forms)


def deforms(mesh: Mesh, shutter: Shutter) -> bool:
    """Whether a mesh changes its form while the shutter is open."""
    if mesh.deformation is None or shutter.open >= shutter.close:
        return False
    needed = form_keys(mesh.deformation, shutter.first, shutter.last)
    return any(key.positions != needed[0].positions for key in needed)
