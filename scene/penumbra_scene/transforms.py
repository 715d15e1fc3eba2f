"""Placing things: steps, applied to points in the order listed, or keyframes of such lists over time."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from penumbra_scene import limits
from penumbra_scene.base import Direction, Float, Model, Vec3, error_at, spread


class LookAtFrame(Model):
    """A frame at `origin` whose -Z axis points at `target`, with `up` in its upper half plane."""

    origin: Vec3
    target: Vec3
    up: Direction = (0.0, 1.0, 0.0)

    @model_validator(mode="after")
    def _not_degenerate(self) -> LookAtFrame:
        f = [t - o for t, o in zip(self.target, self.origin, strict=True)]
        u = self.up
        cross = (f[1] * u[2] - f[2] * u[1], f[2] * u[0] - f[0] * u[2], f[0] * u[1] - f[1] * u[0])
        size = sum(x * x for x in f) * sum(x * x for x in u)
        if sum(x * x for x in cross) <= 1e-12 * size:
            raise error_at(
                "",
                "target equals origin, or up is parallel to the view direction",
                "a target away from the origin, and another up",
            )
        return self


class Rotation(Model):
    """A rotation about an axis through the origin, counter-clockwise seen from the axis' tip."""

    axis: Direction
    angle: Float
    """Degrees."""


class Translate(Model):
    translate: Vec3
    """Metres."""


class Rotate(Model):
    rotate: Rotation


class Scale(Model):
    scale: Annotated[Vec3, BeforeValidator(spread, json_schema_input_type=Vec3 | Float)]
    """A factor an axis, or one number for all three; negative ones mirror."""

    @model_validator(mode="after")
    def _not_singular(self) -> Scale:
        if any(abs(x) < limits.MIN_SCALE for x in self.scale):
            raise error_at("/scale", "a factor is zero, or nearly", f"at least {limits.MIN_SCALE} in size")
        return self


Row4 = tuple[Float, Float, Float, Float]


class Matrix(Model):
    matrix: tuple[Row4, Row4, Row4, Row4]
    """Four rows of four; the last must be 0 0 0 1."""

    @model_validator(mode="after")
    def _affine_and_regular(self) -> Matrix:
        if tuple(self.matrix[3]) != (0.0, 0.0, 0.0, 1.0):
            raise error_at("/matrix/3", "the last row must be [0, 0, 0, 1]", "[0, 0, 0, 1]")
        a, b, c = (row[:3] for row in self.matrix[:3])
        det = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        lengths = [sum(row[j] ** 2 for row in (a, b, c)) ** 0.5 for j in range(3)]
        if abs(det) <= 1e-9 * lengths[0] * lengths[1] * lengths[2] or det == 0:
            raise error_at("/matrix", "squashes space flat", "an upper-left 3x3 part with an inverse")
        return self


class LookAt(Model):
    look_at: LookAtFrame


STEP_KEYS = ("translate", "rotate", "scale", "matrix", "look_at")


def _one_step(value: Any) -> Any:
    """An object of several steps would not say in which order they are meant."""
    found = [key for key in value if key in STEP_KEYS] if isinstance(value, dict) else []
    if len(found) > 1:
        listed = ", ".join(f'{{"{key}": ...}}' for key in found)
        raise error_at("", "holds several steps: one an object, in the order they are applied", f"[{listed}]")
    return value


def _step_tag(value: Any) -> str | None:
    keys = value if isinstance(value, dict) else type(value).model_fields if isinstance(value, Model) else ()
    return next((key for key in STEP_KEYS if key in keys), None)


Step = Annotated[
    Annotated[Translate, Tag("translate")]
    | Annotated[Rotate, Tag("rotate")]
    | Annotated[Scale, Tag("scale")]
    | Annotated[Matrix, Tag("matrix")]
    | Annotated[LookAt, Tag("look_at")],
    Discriminator(
        _step_tag,
        custom_error_type="transform_step",
        custom_error_message="must be an object with one of the keys " + ", ".join(STEP_KEYS),
    ),
    BeforeValidator(_one_step),
]

Steps = Annotated[tuple[Step, ...], Field(max_length=limits.MAX_STEPS)]


def _listed(value: Any) -> Any:
    """One step alone stands for a list of one."""
    if isinstance(value, dict) and "keyframes" not in value:
        return [value]
    return value


class TransformKeyframe(Model):
    time: Float
    """Seconds."""
    transform: Annotated[Steps, BeforeValidator(_listed, json_schema_input_type=Step | Steps)]


class Keyframes(Model):
    """Transforms over time. Between keyframes translation and stretch are interpolated linearly, rotation
    by slerp along the shorter arc; before the first and after the last the transform stands still."""

    keyframes: Annotated[tuple[TransformKeyframe, ...], Field(min_length=1, max_length=limits.MAX_KEYFRAMES)]

    @model_validator(mode="after")
    def _times_rise(self) -> Keyframes:
        times = [k.time for k in self.keyframes]
        if any(b <= a for a, b in pairwise(times)):
            raise error_at("/keyframes", "keyframe times must rise strictly", "times that rise")
        return self


def _transform_tag(value: Any) -> str:
    return "keyframes" if isinstance(value, (dict, Keyframes)) else "steps"


Transform = Annotated[
    Annotated[Steps, Tag("steps")] | Annotated[Keyframes, Tag("keyframes")],
    Discriminator(_transform_tag),
    BeforeValidator(_listed, json_schema_input_type=Step | Steps | Keyframes),
]
"""A step, a list of steps, or {"keyframes": [...]}."""
