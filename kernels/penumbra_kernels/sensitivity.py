"""What each group of random dimensions adds to the noise: first-order sensitivity indices by pick-freeze.

The mean of a replicate is a function of independent random groups: where in the pixel, on the lens, when, where on the lights,
in which directions. Its variance is the sum of what each group does alone and of what they do together (Efron and Stein 1981).
With Y of one draw A of all groups, Y' of another, B, and Y_g of A with group g from B,

    whole          V   = E (Y - Y')^2 / 2
    g alone        V_g = V - E (Y' - Y_g)^2 / 2      (Jansen 1999; Saltelli et al. 2010, table 2 c)
    g with others  T_g = E (Y - Y_g)^2 / 2           (Jansen 1999; Saltelli et al. 2010, table 2 f)

V is taken from the very draws that are compared, as the mean of their two variances: then V_g / V is 2 cov / (var + var), which
lies between -1 and 1 whatever a single bright value does (the estimator T of Janon et al. 2014, asymptotically the best). What
is left, 1 - sum V_g / V, is the interactions': a product of two factors has noise that freezing either one does not remove.

Where a few bright values carry most of the noise, shares of the whole are theirs, and uncertain. So there are shares of a
typical block too: the mean over blocks of each block's own.

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
    error: float | None
    """Its standard error, from the spread over blocks; None where there is one."""
    typical: float
    """Share of the variance in a block, on average over blocks."""
    typical_error: float | None
    """Its standard error; None where one block has noise, or none."""
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


def half_square(a: Array, b: Array) -> Array:
    """Of values (blocks, ...): (blocks,) means of (a - b)^2 / 2 over all but the first axis."""
    return np.asarray((0.5 * (a - b) ** 2).reshape(len(a), -1).mean(axis=1))


def _covariance(a: Array, b: Array) -> Array:
    """Of values (blocks, replicates, ...): (blocks,) means of the covariances over replicates."""
    apart = (a - a.mean(axis=1, keepdims=True)) * (b - b.mean(axis=1, keepdims=True))
    count = max(a.shape[1] - 1, 1)
    return np.asarray((apart.sum(axis=1) / count).reshape(len(a), -1).mean(axis=1))


@dataclass(frozen=True)
class _Part:
    """What blocks say of a group: (blocks,) parts of the variance, and (blocks,) variances."""

    part: Array
    variance: Array

    @property
    def ratio(self) -> float:
        whole = float(self.variance.sum())
        return float(self.part.sum()) / whole if whole > 0.0 else 0.0

    @property
    def influence(self) -> Array:
        """(blocks,) of each block on the ratio (Cochran 1977, section 6.3: the delta method)."""
        mean = float(self.variance.mean())
        return (self.part - self.ratio * self.variance) / mean if mean > 0.0 else np.zeros_like(self.part)

    @property
    def own(self) -> Array:
        """(blocks,) ratios, 0 where there is no noise."""
        return np.divide(self.part, self.variance, out=np.zeros_like(self.part), where=self.variance > 0.0)


def _row(
    group: str, alone: float, influence: Array, own: Array, noisy: NDArray[np.bool_], together: float | None
) -> Share:
    typical = own[noisy]
    return Share(
        group,
        alone,
        _error(influence),
        float(typical.mean()) if len(typical) else 0.0,
        _error(typical),
        together,
    )


def _error(values: Array) -> float | None:
    """Standard error of a mean; None, unknown, of fewer than two values."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None


def shares(first: Array, second: Array, mixed: Mapping[str, Array]) -> tuple[Share, ...]:
    """The table from values (blocks, replicates, ...) of draw A, of draw B, and for each group of A with that group from B.

    Blocks are independent of each other: errors come from their spread. The rows' shares add up to 1 where there is noise.
    """
    spread = {"first": _covariance(first, first), "second": _covariance(second, second)}
    noisy = (spread["first"] > 0.0) & (spread["second"] > 0.0)
    rows = []
    left, influence, own = float(noisy.any()), np.zeros(len(first)), noisy.astype(np.float64)
    for group, values in mixed.items():
        of_mixed = _covariance(values, values)
        alone = _Part(_covariance(second, values), 0.5 * (spread["second"] + of_mixed))
        together = _Part(half_square(first, values), 0.5 * (spread["first"] + of_mixed))
        rows.append(_row(group, alone.ratio, alone.influence, alone.own, noisy, together.ratio))
        left, influence, own = left - alone.ratio, influence - alone.influence, own - alone.own
    return (*rows, _row(INTERACTIONS, left, influence, own, noisy, None))


def peak(first: Array, second: Array) -> float:
    """The share of the whole noise that the noisiest hundredth of the blocks carries, one of them at least."""
    by_block = np.sort(_covariance(first, first) + _covariance(second, second))[::-1]
    whole = float(by_block.sum())
    return float(by_block[: max(len(by_block) // 100, 1)].sum()) / whole if whole > 0.0 else 0.0


def variance_of(first: Array, second: Array) -> tuple[float, float | None]:
    """The whole, V, and its standard error, from the same values as `shares`; None where there is one block."""
    whole = half_square(first, second)
    return float(whole.mean()), _error(whole)


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
                (sums["rgba"][..., :3].astype(np.float64).mean(axis=-1) / taken).reshape(sums.shape[0], -1)
            )
        return np.stack(out)
    finally:
        tracer.other_groups = 0


@dataclass(frozen=True)
class Noise:
    """A scene's table."""

    rows: tuple[Share, ...]
    peak: float
    """See `peak`."""


def measure(tracer: Tracer, tiles: Sequence[Tile], sample_count: int) -> Noise:
    """The table of a scene: a tracer with `measuring`, tiles of one size as blocks. Traces 2 + groups times as much."""
    groups = groups_of(tracer.compiled.features)
    everything = sum(bit_of(group) for group in GROUPS)
    first = values_of(tracer, tiles, sample_count, 0)
    second = values_of(tracer, tiles, sample_count, everything)
    mixed = {group: values_of(tracer, tiles, sample_count, bit_of(group)) for group in groups}
    return Noise(shares(first, second, mixed), peak(first, second))
