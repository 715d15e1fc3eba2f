"""What every model of the contract shares: strictness, and the scalar types with their ranges.

Units: metres, seconds, degrees. Frame: right-handed, Y up. Colours: linear Rec.709.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    StringConstraints,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import PydanticCustomError

from penumbra_scene import limits


class Model(BaseModel):
    """A strict, immutable model: unknown keys, NaN and infinity are errors.

    Nothing is built before it is used: a validator at the first document, the fields' descriptions, which are the strings
    below them, when a schema is asked for. Every process imports these models, few need more than a part of them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in _attribute_docstrings(cls).items():
            if name in properties:
                properties[name].setdefault("description", text)
        return schema


def _attribute_docstrings(model: type[BaseModel]) -> dict[str, str]:
    """The string below each attribute, in the class and those that it comes from."""
    import ast
    import inspect
    from textwrap import dedent

    found: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if not issubclass(cls, Model) or cls is Model:
            continue
        tree = ast.parse(dedent(inspect.getsource(cls))).body[0]
        assert isinstance(tree, ast.ClassDef)
        for attribute, text in pairwise(tree.body):
            match attribute, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(words))),
                ):
                    found[name] = inspect.cleandoc(words)
    return found


def error_at(pointer: str, message: str, accepted: str = "") -> PydanticCustomError:
    """An error for a model's validator to raise that blames `pointer` ('/indices/3') within that model.

    `accepted` where the schema alone does not tell what would be right.
    """
    return PydanticCustomError(
        "inconsistent", "{message}", {"at": pointer, "message": message, "accepted": accepted}
    )


def _reject_boolean(value: Any) -> Any:
    """Python takes True for 1; a document that says true where a number belongs is wrong."""
    if isinstance(value, (bool, str)):
        raise PydanticCustomError("not_a_number", "must be a number")
    return value


NotBoolean = BeforeValidator(_reject_boolean)

# `strict` refuses booleans and strings and still takes 1 for 1.0, without calling Python for each number.
Float = Annotated[float, Field(strict=True, ge=-limits.MAX_MAGNITUDE, le=limits.MAX_MAGNITUDE)]
"""A finite number that float32 arithmetic can square."""
Positive = Annotated[float, Field(strict=True, gt=0, le=limits.MAX_MAGNITUDE)]
NonNegative = Annotated[float, Field(strict=True, ge=0, le=limits.MAX_MAGNITUDE)]
Measured = Annotated[float, Field(strict=True, ge=0)]
"""Any finite number from 0: what the service measures is squared radiance, and knows no limit of scenes."""
Unit = Annotated[float, Field(strict=True, ge=0, le=1)]
Integer = Annotated[int, NotBoolean]
"""A whole number; 3.0 is one as well."""
Bool = Annotated[bool, Field(strict=True)]

Vec3 = tuple[Float, Float, Float]
Vec2 = tuple[Float, Float]


def _nonzero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(abs(x) for x in vector) < limits.MIN_DIRECTION:
        raise PydanticCustomError(
            "zero_direction", "must have a component of at least {least}", {"least": limits.MIN_DIRECTION}
        )
    return vector


Direction = Annotated[Vec3, AfterValidator(_nonzero)]
"""A direction; need not be normalised, must not be zero."""

Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]
"""A name that other parts of the scene refer to."""


def spread(value: Any) -> Any:
    """One number stands for three equal ones."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value, value)
    return value


_Light3 = tuple[NonNegative, NonNegative, NonNegative]
Radiance = Annotated[_Light3, BeforeValidator(spread, json_schema_input_type=_Light3 | NonNegative)]
"""Emitted light, linear Rec.709; one number means gray. Unit: see the field."""

_Unit3 = tuple[Unit, Unit, Unit]
Reflectance = Annotated[_Unit3, BeforeValidator(spread, json_schema_input_type=_Unit3 | Unit)]
"""A reflectance, linear Rec.709, each channel in [0, 1]; one number means gray."""
