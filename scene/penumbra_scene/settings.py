"""How a scene is rendered: integrator, sampler, and when to stop."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, StringConstraints, model_validator
from pydantic_core import PydanticCustomError

from penumbra_scene import limits
from penumbra_scene.base import Bool, Model, NotBoolean, Positive


class Integrator(Model):
    """Recursive path tracing with next-event estimation and multiple importance sampling."""

    max_bounces: Annotated[int, Field(ge=0, le=limits.MAX_BOUNCES), NotBoolean] = 16
    """Reflections and transmissions that a path may make after the first hit; 0 is direct light only."""
    roulette_start: Annotated[int, Field(ge=0, le=limits.MAX_BOUNCES), NotBoolean] = 4
    """Bounces before Russian roulette may end a path; survival is min(1, throughput)."""
    light_selection: Literal["auto", "all", "uniform", "power", "tree"] = "auto"
    """Which lights a hit asks: every one, or `shadow_rays` picks by equal chance, by power, or by a light tree, which
    also knows where they are. `auto` is the tree where it pays, by how many lights of which kinds there are,
    and power elsewhere."""
    shadow_rays: Annotated[int, Field(ge=1, le=limits.MAX_SHADOW_RAYS), NotBoolean] = 1
    """Shadow rays per light (all), or picks per hit (uniform, power, tree)."""
    light_sampling: Literal["solid_angle", "area"] = "solid_angle"
    """The density on an area light: uniform in the solid angle that it subtends, or uniform over its area."""
    mis: Bool = True
    """Weigh light samples against lobe samples (Veach's power heuristic); without it, light samples only."""


_SeedText = Annotated[str, StringConstraints(pattern=r"^[0-9]{1,20}$")]


def _seed(value: Any) -> Any:
    if isinstance(value, bool):
        raise PydanticCustomError("seed", "must be an integer from 0 to 2^64-1, or the same as a string")
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 20:
        return int(value)
    return value


def _seed_to_json(seed: int) -> int | str:
    """JavaScript and many others read JSON numbers as doubles, which are exact up to 2^53 only."""
    return seed if seed <= 2**53 else str(seed)


Seed = Annotated[
    int,
    Field(ge=0, lt=2**64),
    BeforeValidator(_seed, json_schema_input_type=Annotated[int, Field(ge=0, lt=2**64)] | _SeedText),
    PlainSerializer(_seed_to_json, return_type=int | str, when_used="json"),
]
"""64 bits; write large ones as strings, since JSON numbers lose bits beyond 2^53."""


class Sampler(Model):
    type: Literal["regular", "random", "independent", "stratified", "jittered", "sobol", "blue_noise"] = (
        "sobol"
    )
    seed: Seed = 0
    replicates: Annotated[Literal[1, 2, 4, 8, 16], NotBoolean] | None = None
    """Independent replicates a pixel: their spread is the variance. Default 4, fewer for few samples."""


class Stop(Model):
    """When a render ends: whichever comes first. Without any, 64 samples a pixel."""

    samples: Annotated[int, Field(ge=1, le=limits.MAX_SAMPLES), NotBoolean] | None = None
    """A pixel."""
    seconds: Annotated[Positive, Field(le=limits.MAX_SECONDS)] | None = None
    """Of tracing."""
    relative_error: Annotated[Positive, Field(le=1)] | None = None
    """sqrt(relmse) of the picture, e.g. 0.02 for 2 %."""
    confidence: Annotated[Positive, Field(gt=0.5, lt=1)] = 0.95

    @model_validator(mode="before")
    @classmethod
    def _some_rule(cls, data: Any) -> Any:
        if isinstance(data, dict) and not any(
            data.get(k) is not None for k in ("samples", "seconds", "relative_error")
        ):
            return {**data, "samples": 64}
        return data
