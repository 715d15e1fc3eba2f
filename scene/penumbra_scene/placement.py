"""Transforms as matrices, in plain Python: enough to check them. Points are columns: p' = M p; metres."""

from __future__ import annotations

import math
from collections.abc import Iterator

from penumbra_scene.transforms import (
    Keyframes,
    LookAt,
    LookAtFrame,
    Matrix,
    Rotate,
    Rotation,
    Scale,
    Step,
    Translate,
)

Row = tuple[float, float, float, float]
Affine = tuple[Row, Row, Row]
"""The upper three rows of a 4 x 4 matrix; metres."""

IDENTITY: Affine = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))


def placements(transform: tuple[Step, ...] | Keyframes) -> Iterator[Affine]:
    """The matrix of a transform, or one for each of its keyframes."""
    if isinstance(transform, Keyframes):
        for keyframe in transform.keyframes:
            yield compose(keyframe.transform)
    else:
        yield compose(transform)


def compose(steps: tuple[Step, ...]) -> Affine:
    """The product of steps that are applied in the order listed."""
    result = IDENTITY
    for step in steps:
        result = multiply(step_matrix(step), result)
    return result


def multiply(a: Affine, b: Affine) -> Affine:
    """a b: first b, then a."""

    def row(r: Row) -> Row:
        x, y, z = (sum(r[k] * b[k][j] for k in range(3)) for j in range(3))
        return (x, y, z, sum(r[k] * b[k][3] for k in range(3)) + r[3])

    return (row(a[0]), row(a[1]), row(a[2]))


def step_matrix(step: Step) -> Affine:
    """One step as a matrix."""
    if isinstance(step, Translate):
        x, y, z = step.translate
        return ((1.0, 0.0, 0.0, x), (0.0, 1.0, 0.0, y), (0.0, 0.0, 1.0, z))
    if isinstance(step, Rotate):
        return _rotation(step.rotate)
    if isinstance(step, Scale):
        x, y, z = step.scale
        return ((x, 0.0, 0.0, 0.0), (0.0, y, 0.0, 0.0), (0.0, 0.0, z, 0.0))
    if isinstance(step, Matrix):
        return (step.matrix[0], step.matrix[1], step.matrix[2])
    assert isinstance(step, LookAt)
    return _look_at(step.look_at)


def _rotation(rotation: Rotation) -> Affine:
    """Rodrigues' formula."""
    x, y, z = _unit(rotation.axis)
    angle = math.radians(math.fmod(rotation.angle, 360.0))
    c, s = math.cos(angle), math.sin(angle)
    t = 1.0 - c
    return (
        (t * x * x + c, t * x * y - s * z, t * x * z + s * y, 0.0),
        (t * x * y + s * z, t * y * y + c, t * y * z - s * x, 0.0),
        (t * x * z - s * y, t * y * z + s * x, t * z * z + c, 0.0),
    )


def _look_at(frame: LookAtFrame) -> Affine:
    """Columns: right, up, backwards, origin."""
    o, t = frame.origin, frame.target
    z = _unit((o[0] - t[0], o[1] - t[1], o[2] - t[2]))
    x = _unit(_cross(_unit(frame.up), z))
    y = _cross(z, x)
    return ((x[0], y[0], z[0], o[0]), (x[1], y[1], z[1], o[1]), (x[2], y[2], z[2], o[2]))


def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _unit(v: tuple[float, float, float]) -> tuple[float, float, float]:
    length = math.hypot(*v)
    return (v[0] / length, v[1] / length, v[2] / length)
