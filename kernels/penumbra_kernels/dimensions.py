"""How many random numbers a scene's program draws: at most, by the effects that are in, and really, as its paths count them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from penumbra_kernels.features import Features

if TYPE_CHECKING:
    from penumbra_kernels.nodes import Tile
    from penumbra_kernels.tracer import Tracer

DRAWN: Final = (
    "pixel",
    "lens",
    "time",
    "point on the light",
    "lobe",
    "direction",
    "roulette",
    "triangle of the light",
)
"""Dimensions in the order of the counters (cl/base/dimensions.h): the camera's, then the slots of hits."""

CAMERA: Final[tuple[tuple[str, int, tuple[str, ...]], ...]] = (
    ("pixel", 2, ()),
    ("lens", 2, ("lens",)),
    ("time", 1, ("motion", "camera_motion", "deformation")),
)
"""(dimension, numbers, effects of which any draws it; none: always), once for a camera path (cl/base/dimensions.h)."""
HIT: Final[tuple[tuple[str, int, tuple[str, ...]], ...]] = (
    ("point on the light", 2, ("many_lights", "area_lights", "environment")),
    ("triangle of the light", 1, ("area_lights",)),
    ("lobe", 1, ("transmission",)),
    ("direction", 2, ("indirect",)),
    ("roulette", 1, ("indirect",)),
)
"""The same for every hit, at most: for each shadow ray, and where the material asks for it."""


def _sum(table: tuple[tuple[str, int, tuple[str, ...]], ...], features: Features) -> int:
    return sum(count for _, count, effects in table if not effects or any(e in features for e in effects))


def numbers_drawn(features: Features) -> tuple[int, int]:
    """(for the camera's ray, at most for a hit with one shadow ray)."""
    return _sum(CAMERA, features), _sum(HIT, features)


def drawn_per_path(tracer: Tracer, tiles: Sequence[Tile], sample_count: int) -> dict[str, float]:
    """Numbers that a camera path draws in each dimension, counted over blocks by a tracer that is `measuring`; without the
    dimensions that are not drawn from."""
    before, paths = tracer.drawn.copy(), 0
    for tile in tiles:
        sums = tracer.trace(tile, 0, sample_count).sums
        paths += int(sums["taken"].sum() + sums["rejected"].sum())
    counts = zip(DRAWN, tracer.drawn - before, strict=True)
    return {name: count / max(paths, 1) for name, count in counts if count}
