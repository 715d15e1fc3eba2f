"""What every model of the contract shares: strictness, and the scalar types with their ranges.

Units: metres, seconds, degrees. Frame: right-handed, Y up. Colours: linear Rec.709.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

from penumbra_scene import limits


class Model(BaseModel):
    """A strict, immutable model: unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


def _reject_booleans_and_strings(value: Any) -> Any:
    if isinstance(value, (bool, str)):
        raise ValueError("must be a number")
    return value


_Number = BeforeValidator(_reject_booleans_and_strings)

Float = Annotated[float, _Number, Field(ge=-limits.MAX_MAGNITUDE, le=limits.MAX_MAGNITUDE)]
"""A finite number that float32 arithmetic can square."""
Positive = Annotated[float, _Number, Field(gt=0, le=limits.MAX_MAGNITUDE)]
NonNegative = Annotated[float, _Number, Field(ge=0, le=limits.MAX_MAGNITUDE)]
Unit = Annotated[float, _Number, Field(ge=0, le=1)]
Integer = Annotated[int, _Number]

Vec3 = tuple[Float, Float, Float]
Vec2 = tuple[Float, Float]


def _nonzero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(abs(x) for x in vector) < limits.MIN_DIRECTION:
        raise ValueError(f"must have a component of at least {limits.MIN_DIRECTION}")
    return vector


Direction = Annotated[Vec3, AfterValidator(_nonzero)]
"""A direction; need not be normalised, must not be zero."""

Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]
"""A name that other parts of the scene refer to."""


def _spread_gray(value: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value, value)
    return value


Radiance = Annotated[tuple[NonNegative, NonNegative, NonNegative], BeforeValidator(_spread_gray)]
"""Emitted light, linear Rec.709; one number means gray. Unit: see the field."""

Reflectance = Annotated[tuple[Unit, Unit, Unit], BeforeValidator(_spread_gray)]
"""A reflectance, linear Rec.709, each channel in [0, 1]; one number means gray."""
