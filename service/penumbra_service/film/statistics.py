"""A pixel's mean and the variance of that mean, from the spread of its replicates. Linear Rec.709, full-frame
pixels.

m = average of the replicate means m_r over the R' replicates that have samples; V = sum (m_r - m)^2 / (R' (R'
- 1)). Since E (m_r - m)^2 summed is (1 - 1/R') sum Var(m_r), V is unbiased for Var(m) whatever the sampler
does inside a replicate, and also where the replicates have different numbers of samples; it equals the
delete-one jackknife of m.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film import flags
from penumbra_service.film.grid import FLAG_BLOCK, block_starts
from penumbra_service.film.student import quantile

LUMINANCE: Final = (0.2126, 0.7152, 0.0722)
"""Rec.709."""
OUTLIER_LEVEL: Final = 1e-4
"""Chance that Grubbs' test flags a pixel with normal replicate means: 0.6 % of calm 8x8 blocks."""
FEW_LIT_SAMPLES: Final = 16
"""Below this many samples with light (and fewer than half of all) a pixel is FEW_LIT. Measured on on/off
light with R = 8: coverage .94 at an expected 15 lit samples, .89 at 5, .57 at 1; a block's darkest of 64
pixels must reach 16."""
ROUNDING: Final = 2.0**-20
"""Replicates that differ by less than this fraction of the mean differ by rounding alone: a pairwise float32
sum of 2^8 samples errs by up to 8 * 2^-24 = 2^-21 of the sum of magnitudes, and two of them are compared."""

LARGEST: Final = float(np.finfo(np.float32).max)
"""What stands for a mean whose float32 sum has overflowed."""


@dataclass(frozen=True)
class PixelStatistics:
    """Of the pixels of one tile."""

    tile: Tile
    mean: NDArray[np.float64]
    """(height, width, 4), R G B A."""
    variance: NDArray[np.float64]
    """(height, width, 4): of the mean, NaN where it is not known."""
    replicates: NDArray[np.int64]
    """(height, width): replicates with samples."""
    taken: NDArray[np.uint64]
    """(height, width): samples that count, over all replicates."""
    lit: NDArray[np.uint64]
    rejected: NDArray[np.uint64]
    rejected_in: NDArray[np.uint32]
    rays: NDArray[np.uint64]
    """(height, width): traced by all samples, rejected ones included."""
    largest_share: NDArray[np.float64]
    """(height, width): largest squared deviation of a replicate's luminance over their sum; at most (R - 1) /
    R."""
    calm: NDArray[np.bool_]
    """(height, width): whether the replicates differ by rounding alone."""


Sums = NDArray[Any] | Mapping[str, NDArray[Any]]
"""(replicates, height, width) of SUM or SUM64, or their fields one by one."""


def pixel_statistics(tile: Tile, sums: Sums, *, deterministic: bool = False) -> PixelStatistics:
    """Statistics of a tile's sums, which hold all of its samples."""
    taken = np.ascontiguousarray(sums["taken"])
    there = taken > 0
    counts = there.sum(axis=0)
    means = sums["rgba"] / np.maximum(taken, 1).astype(np.float64)[..., None]
    mean = means.sum(axis=0) / np.maximum(counts, 1)[..., None]
    overflowed = _cap(mean)
    with np.errstate(invalid="ignore"):  # inf - inf; such pixels are settled below
        deviations = np.subtract(means, mean, out=means)
    if not there.all():
        deviations[~there] = 0.0
    if overflowed is not None:
        deviations[:, overflowed] = 0.0
    variance = _variance(deviations, counts, deterministic)
    if overflowed is not None:
        variance[overflowed] = np.nan
    share, calm = _largest_share(deviations, mean)
    return PixelStatistics(
        tile,
        mean,
        variance,
        counts,
        taken.sum(axis=0, dtype=np.uint64),
        sums["lit"].sum(axis=0, dtype=np.uint64),
        sums["rejected"].sum(axis=0, dtype=np.uint64),
        np.bitwise_or.reduce(sums["rejected_in"], axis=0),
        sums["rays"].sum(axis=0, dtype=np.uint64),
        share,
        calm,
    )


def _cap(mean: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Replaces means that are beyond float32, in place; (height, width): which pixels had any, None for none. Samples
    are finite, so that only their float32 sum can be infinite (or, under a filter with negative lobes, NaN)."""
    if math.isfinite(mean.sum()):
        return None
    overflowed: NDArray[np.bool_] = ~np.isfinite(mean).all(axis=-1)
    mean[overflowed] = np.nan_to_num(mean[overflowed], nan=LARGEST, posinf=LARGEST, neginf=-LARGEST)
    return overflowed


def _variance(deviations: NDArray[Any], counts: NDArray[Any], deterministic: bool) -> NDArray[np.float64]:
    squares = np.einsum("rhwc,rhwc->hwc", deviations, deviations)
    most = len(deviations)
    if most >= 2 and not deterministic and counts.min(initial=most) == most:
        return np.asarray(squares / (most * (most - 1)))
    known = (counts >= 2) & (not deterministic)
    divisor = np.where(known, counts * (counts - 1), 1)[..., None]
    return np.where(known[..., None], squares / divisor, np.nan)


def _largest_share(
    deviations: NDArray[Any], mean: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    squares = np.square(_luminance(deviations))
    total = squares.sum(axis=0)
    largest = squares.max(axis=0)
    calm = np.sqrt(largest) <= ROUNDING * np.abs(_luminance(mean))
    share = np.divide(largest, total, out=np.zeros_like(total), where=total > 0)
    return share, calm


def _luminance(rgba: NDArray[Any]) -> NDArray[np.float64]:
    """Written out, since a matrix product's bits depend on the machine's BLAS."""
    red, green, blue = LUMINANCE
    result: NDArray[np.float64] = rgba[..., 0] * red + rgba[..., 1] * green + rgba[..., 2] * blue
    return result


@functools.cache
def outlier_share(replicates: int, level: float = OUTLIER_LEVEL) -> float:
    """The share of the largest squared deviation above which a replicate is an outlier, 2 where none can be
    one.

    Grubbs (1969): G = (R-1)/sqrt(R) sqrt(t^2 / (R-2 + t^2)) with t the upper level/(2R) point of Student's t
    with R-2 degrees; since sum of squares = (R-1) s^2, the share is G^2 / (R-1). With R = 3 and less the test
    has no power.
    """
    if replicates < 4:
        return 2.0
    t = quantile(replicates - 2, level / (2 * replicates))
    return (replicates - 1) / replicates * t * t / (replicates - 2 + t * t)


def pixel_flags(pixels: PixelStatistics, *, deterministic: bool = False) -> NDArray[np.uint32]:
    """(height, width) of `flags` bits. The tile must consist of whole 8x8 blocks, but for the window's own
    edges."""
    bits = np.zeros(pixels.taken.shape, np.uint32)
    empty = pixels.taken == 0
    bits[empty] |= flags.EMPTY
    bits[pixels.rejected > 0] |= flags.REJECTED
    bits |= pixels.rejected_in.astype(np.uint32) << np.uint32(flags.EFFECT_SHIFT)
    if deterministic:
        bits |= np.uint32(flags.DETERMINISTIC)
        return bits
    bits[np.isnan(pixels.variance[..., 0])] |= flags.NO_VARIANCE
    bits[_heavy_tailed(pixels)] |= flags.HEAVY_TAILED
    few = (pixels.lit > 0) & (pixels.lit < FEW_LIT_SAMPLES) & (2 * pixels.lit < pixels.taken)
    bits[few] |= flags.FEW_LIT
    return _spread(bits, pixels.tile)


def _heavy_tailed(pixels: PixelStatistics) -> NDArray[np.bool_]:
    most = int(pixels.replicates.max(initial=0))
    thresholds = np.array([outlier_share(r) for r in range(most + 1)])
    heavy: NDArray[np.bool_] = (pixels.largest_share > thresholds[pixels.replicates]) & ~pixels.calm
    return heavy


def _spread(bits: NDArray[np.uint32], tile: Tile) -> NDArray[np.uint32]:
    rows = block_starts(tile.y, tile.height, FLAG_BLOCK)
    columns = block_starts(tile.x, tile.width, FLAG_BLOCK)
    bad = (bits & flags.SPREADING) != 0
    blocks = np.logical_or.reduceat(np.logical_or.reduceat(bad, rows, axis=0), columns, axis=1)
    spread = np.repeat(blocks, _lengths(rows, tile.height), axis=0)
    spread = np.repeat(spread, _lengths(columns, tile.width), axis=1)
    result: NDArray[np.uint32] = bits | np.where(spread, np.uint32(flags.BLOCK), np.uint32(0))
    return result


def _lengths(starts: list[int], count: int) -> NDArray[np.int64]:
    return np.diff([*starts, count])


@functools.cache
def t_quantile(confidence: float, degrees: int) -> float:
    """Two-sided Student quantile: m +- t sqrt(V) covers with this confidence. `degrees` is R - 1, at least
    1."""
    return quantile(degrees, (1 - confidence) / 2)


def interval(pixels: PixelStatistics, confidence: float = 0.95) -> tuple[NDArray[Any], NDArray[Any]]:
    """Lower and upper ends (height, width, 4) of the t-interval of each pixel's value, NaN where V is."""
    most = int(pixels.replicates.max(initial=0))
    quantiles = np.array([math.nan if r < 2 else t_quantile(confidence, r - 1) for r in range(most + 1)])
    half = quantiles[pixels.replicates][..., None] * np.sqrt(pixels.variance)
    return pixels.mean - half, pixels.mean + half
