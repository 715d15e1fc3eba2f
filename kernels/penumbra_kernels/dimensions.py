"""How many random numbers a scene's program draws: the dimensions of the effects that are in, and no others."""

from __future__ import annotations

from typing import Final

from penumbra_kernels.features import Features

CAMERA: Final[tuple[tuple[str, int, tuple[str, ...]], ...]] = (
    ("pixel", 2, ()),
    ("lens", 2, ("lens",)),
    ("time", 1, ("motion", "camera_motion", "deformation")),
)
"""(dimension, numbers, effects of which any draws it; none: always), once for a camera path (cl/base/dimensions.h)."""
HIT: Final[tuple[tuple[str, int, tuple[str, ...]], ...]] = (
    ("light choice", 1, ("many_lights",)),
    ("point on the light", 2, ("area_lights", "environment")),
    ("lobe", 1, ("gloss", "transmission")),
    ("direction", 2, ("indirect",)),
    ("roulette", 1, ("indirect",)),
)
"""The same for every hit, at most: for each shadow ray, and where the material asks for it."""


def _sum(table: tuple[tuple[str, int, tuple[str, ...]], ...], features: Features) -> int:
    return sum(count for _, count, effects in table if not effects or any(e in features for e in effects))


def numbers_drawn(features: Features) -> tuple[int, int]:
    """(for the camera's ray, at most for a hit with one shadow ray)."""
    return _sum(CAMERA, features), _sum(HIT, features)
