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
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film import flags
from penumbra_service.film.grid import FLAG_BLOCK, block_lengths, block_starts
from penumbra_service.film.scratch import Empty
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


Sums = NDArray[Any] | Mapping[str, NDArray[Any]]
"""(replicates, height, width) of SUM or SUM64, or their fields one by one."""


@dataclass(frozen=True)
class PixelStatistics:
    """Of the pixels of one tile. What a look at the error has no need of is computed when it is asked for."""

    tile: Tile
    mean: NDArray[np.float64]
    """(height, width, 4), R G B A."""
    variance: NDArray[np.float64]
    """(height, width, 4): of the mean, NaN where it is not known."""
    sums: Sums
    deviations: NDArray[np.float64]
    """(replicates, height, width, 4): of the replicates' means from the mean; 0 where a replicate has no sample."""

    @cached_property
    def replicates(self) -> NDArray[np.int64]:
        """(height, width): replicates with samples."""
        return np.asarray((self.sums["taken"] > 0).sum(axis=0), np.int64)

    @cached_property
    def taken(self) -> NDArray[np.uint64]:
        """(height, width): samples that count, over all replicates."""
        return self._total("taken")

    @cached_property
    def lit(self) -> NDArray[np.uint64]:
        """(height, width): of these, samples that carried light."""
        return self._total("lit")

    @cached_property
    def rejected(self) -> NDArray[np.uint64]:
        """(height, width): samples that do not count."""
        return self._total("rejected")

    @cached_property
    def rejected_in(self) -> NDArray[np.uint32]:
        """(height, width): bits of the effects that rejected samples had met."""
        return np.asarray(np.bitwise_or.reduce(self.sums["rejected_in"], axis=0), np.uint32)

    @cached_property
    def rays(self) -> NDArray[np.uint64]:
        """(height, width): traced by all samples, rejected ones included."""
        return self._total("rays")

    @cached_property
    def largest_share(self) -> NDArray[np.float64]:
        """(height, width): largest squared deviation of a replicate's luminance over their sum; at most (R - 1) / R."""
        squares = self._squares
        total = squares.sum(axis=0)
        largest = squares.max(axis=0)
        return np.asarray(np.divide(largest, total, out=np.zeros_like(total), where=total > 0))

    @cached_property
    def calm(self) -> NDArray[np.bool_]:
        """(height, width): whether the replicates differ by rounding alone."""
        largest = np.sqrt(self._squares.max(axis=0))
        return np.asarray(largest <= ROUNDING * np.abs(_luminance(self.mean)))

    @cached_property
    def _squares(self) -> NDArray[np.float64]:
        """(replicates, height, width): of the deviations' luminance."""
        return np.square(_luminance(self.deviations))

    def _total(self, name: str) -> NDArray[np.uint64]:
        return np.asarray(self.sums[name].sum(axis=0, dtype=np.uint64))


def pixel_statistics(
    tile: Tile, sums: Sums, *, deterministic: bool = False, empty: Empty = np.empty
) -> PixelStatistics:
    """Statistics of a tile's sums, which hold all of its samples, in arrays that `empty` makes."""
    rgba = sums["rgba"].transpose(3, 0, 1, 2)  # planes of channels, as FoldedSums has them
    taken = sums["taken"]
    least, most = int(taken.min(initial=0)), int(taken.max(initial=0))
    complete = least > 0
    there = taken > 0
    counts = len(taken) if complete else there.sum(axis=0)
    divisor = most if least == most > 0 else np.maximum(taken, 1, out=empty(taken.shape))
    means = np.divide(rgba, divisor, out=empty(rgba.shape))
    mean = means.sum(axis=1, out=empty((4, *taken.shape[1:])), initial=0.0)
    mean /= counts if complete else np.maximum(counts, 1)
    overflowed = _cap(mean)
    if overflowed is None:
        deviations = np.subtract(means, mean[:, None], out=means)
    else:
        with np.errstate(invalid="ignore"):  # inf - inf; such pixels are settled below
            deviations = np.subtract(means, mean[:, None], out=means)
    if not complete:
        deviations[:, ~there] = 0.0
    if overflowed is not None:
        deviations[:, :, overflowed] = 0.0
    variance = np.einsum("crhw,crhw->chw", deviations, deviations, out=empty(mean.shape))
    _divide(variance, counts, deterministic)
    if overflowed is not None:
        variance[:, overflowed] = np.nan
    of_pixels = mean.transpose(1, 2, 0), variance.transpose(1, 2, 0)
    return PixelStatistics(tile, *of_pixels, sums, deviations.transpose(1, 2, 3, 0))


def _cap(mean: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Replaces means (4, height, width) that are beyond float32, in place; (height, width): which pixels had any, None for
    none. Samples are finite, so that only their float32 sum can be infinite (or, under a filter with negative lobes,
    NaN)."""
    if math.isfinite(mean.sum()):
        return None
    overflowed: NDArray[np.bool_] = ~np.isfinite(mean).all(axis=0)
    capped = np.nan_to_num(mean[:, overflowed], nan=LARGEST, posinf=LARGEST, neginf=-LARGEST)
    mean[:, overflowed] = capped
    return overflowed


def _divide(squares: NDArray[Any], counts: int | NDArray[np.int64], deterministic: bool) -> None:
    """Makes variances of sums of squares (4, height, width), in place. counts: replicates with samples, one number where
    all pixels have as many."""
    if isinstance(counts, int) and counts >= 2 and not deterministic:
        squares /= counts * (counts - 1)
        return
    counts = np.asarray(counts)
    known = (counts >= 2) & (not deterministic)
    squares /= np.where(known, counts * (counts - 1), np.nan)


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
    spread = np.repeat(blocks, block_lengths(tile.y, tile.height, FLAG_BLOCK), axis=0)
    spread = np.repeat(spread, block_lengths(tile.x, tile.width, FLAG_BLOCK), axis=1)
    result: NDArray[np.uint32] = bits | np.where(spread, np.uint32(flags.BLOCK), np.uint32(0))
    return result


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
