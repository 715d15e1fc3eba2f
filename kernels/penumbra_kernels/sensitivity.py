"""What each group of random dimensions adds to the noise: first-order sensitivity indices by pick-freeze.

The mean of a replicate is a function of independent random groups: where in the pixel, on the lens, when, where on the lights,
in which directions. Its variance is the sum of what each group does alone and of what they do together (Efron and Stein 1981).
With Y of one draw A of all groups, Y' of another, B, and Y_g of A with group g from B,

    whole          V   = E (Y - Y')^2 / 2
    g alone        V_g = V - E (Y' - Y_g)^2 / 2      (Jansen 1999; Saltelli et al. 2010, table 2 c)
    g with others  T_g = E (Y - Y_g)^2 / 2           (Jansen 1999; Saltelli et al. 2010, table 2 f)

What is left, V - sum V_g, is the interactions': a product of two factors has noise that freezing either one does not remove.
Everything is estimated for the sampler and the number of samples that a render has: a sampler that spreads the pixel's points
well leaves the pixel little of the noise. Values are radiance averaged over R, G and B; expectations go over replicates and
pixels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import CONSTANTS

if TYPE_CHECKING:
    from penumbra_kernels.features import Features
    from penumbra_kernels.nodes import Tile
    from penumbra_kernels.tracer import Tracer

Array = NDArray[np.float64]

GROUPS: Final = ("pixel", "lens", "time", "lights", "directions")
"""By the name of their GROUP_* bit in lower case."""
INTERACTIONS: Final = "interactions"
DETERMINISTIC: Final = frozenset({"regular"})
"""Samplers without noise."""


@dataclass(frozen=True)
class Share:
    """One row of the table."""

    group: str
    alone: float
    """Share of the variance of a replicate's mean. Estimated: may come out a little below 0."""
    error: float
    """Its standard error."""
    together: float | None
    """The share that the group has a part in, interactions included; None for the interactions' own row."""


def groups_of(features: Features) -> tuple[str, ...]:
    """The groups from which a scene's program draws."""
    needs = {
        "pixel": ("pixel",),
        "lens": ("lens",),
        "time": ("motion", "camera_motion", "deformation"),
        "lights": ("area_lights", "environment", "many_lights"),
        "directions": ("indirect",),
    }
    return tuple(g for g in GROUPS if g == "pixel" or any(effect in features for effect in needs[g]))


def bit_of(group: str) -> int:
    """The group's GROUP_* bit."""
    return CONSTANTS[f"GROUP_{group.upper()}"]


def _ratio(numerator: Array, denominator: Array) -> tuple[float, float]:
    """Ratio of two means over blocks, and its standard error (Cochran 1977, section 6.3: the delta method)."""
    whole = float(denominator.mean())
    if whole <= 0.0:
        return 0.0, 0.0
    ratio = float(numerator.mean()) / whole
    count = len(numerator)
    spread = float(((numerator - ratio * denominator) ** 2).sum()) / max(count - 1, 1)
    return ratio, float(np.sqrt(spread / count)) / whole


def half_square(a: Array, b: Array) -> Array:
    """Of values (blocks, ...): (blocks,) means of (a - b)^2 / 2 over all but the first axis."""
    return np.asarray((0.5 * (a - b) ** 2).reshape(len(a), -1).mean(axis=1))


def shares(first: Array, second: Array, mixed: Mapping[str, Array]) -> tuple[Share, ...]:
    """The table from values (blocks, ...) of draw A, of draw B, and for each group of A with that group from B.

    Blocks are independent of each other: errors come from their spread. The rows' shares add up to 1 where there is noise.
    """
    whole = half_square(first, second)
    rows = []
    left = whole.copy()
    for group, values in mixed.items():
        alone = whole - half_square(second, values)
        left -= alone
        share, error = _ratio(alone, whole)
        together, _ = _ratio(half_square(first, values), whole)
        rows.append(Share(group, share, error, together))
    share, error = _ratio(left, whole)
    return (*rows, Share(INTERACTIONS, share, error, None))


def variance_of(first: Array, second: Array) -> tuple[float, float]:
    """The whole, V, and its standard error, from the same values as `shares`."""
    whole = half_square(first, second)
    return float(whole.mean()), float(whole.std(ddof=1) / np.sqrt(len(whole))) if len(whole) > 1 else 0.0


def values_of(tracer: Tracer, tiles: Sequence[Tile], sample_count: int, other_groups: int) -> Array:
    """(tiles, replicates, pixels) means of the samples 0 ... sample_count - 1, with these groups from the second stream.

    Tiles have one size. A replicate without samples (sampler `random`) counts as black.
    """
    tracer.other_groups = other_groups
    try:
        out = []
        for tile in tiles:
            sums = tracer.trace(tile, 0, sample_count).sums
            taken = np.maximum(sums["taken"].astype(np.float64), 1.0)
            out.append(
                (sums["rgba"][..., :3].astype(np.float64).mean(axis=-1) / taken).reshape(len(sums), -1)
            )
        return np.stack(out)
    finally:
        tracer.other_groups = 0


def measure(tracer: Tracer, tiles: Sequence[Tile], sample_count: int) -> tuple[Share, ...]:
    """The table of a scene: a tracer with `measuring`, tiles of one size as blocks. Traces 2 + groups times as much."""
    groups = groups_of(tracer.compiled.features)
    everything = sum(bit_of(group) for group in GROUPS)
    first = values_of(tracer, tiles, sample_count, 0)
    second = values_of(tracer, tiles, sample_count, everything)
    mixed = {group: values_of(tracer, tiles, sample_count, bit_of(group)) for group in groups}
    return shares(first, second, mixed)
