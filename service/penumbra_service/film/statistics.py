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
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sums import Sums

from penumbra_service.film import flags
from penumbra_service.film.accumulator import FoldedSums
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


@dataclass(frozen=True)
class PixelStatistics:
    """Of the pixels of one tile. What a look at the error has no need of is computed when it is asked for."""

    tile: Tile
    mean: NDArray[np.float64]
    """(height, width, 4), R G B A."""
    variance: NDArray[np.float64]
    """(height, width, 4): of the mean, NaN where it is not known. R G B alone where alpha's is not asked for."""
    sums: FoldedSums
    deviations: NDArray[np.float64]
    """(replicates, height, width, as many): of the replicates' means from the mean, times `scale`; 0 where a replicate has no
    sample."""
    scale: int

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
        return np.square(_luminance(self.deviations) / self.scale)

    def _total(self, name: str) -> NDArray[np.uint64]:
        return np.asarray(self.sums[name].sum(axis=0, dtype=np.uint64))


def pixel_statistics(
    tile: Tile,
    sums: Sums | FoldedSums,
    *,
    deterministic: bool = False,
    empty: Empty = np.empty,
    of_alpha: bool = True,
) -> PixelStatistics:
    """Statistics of a tile's sums, which hold all of its samples, in arrays that `empty` makes. of_alpha: whether alpha's
    variance is asked for."""
    folded = sums if isinstance(sums, FoldedSums) else FoldedSums([sums], sums.shape, empty)
    given = _replicates_of(folded, empty)
    mean = given.centre
    deviations, of_them = (given.values, mean) if of_alpha else (given.values[:3], mean[:3])
    finite = math.isfinite(mean.sum())
    with np.errstate(invalid="warn" if finite else "ignore"):  # inf - inf; such pixels are settled below
        deviations -= of_them[:, None]
    if given.missing is not None:
        deviations[:, given.missing] = 0.0
    mean *= 1 / given.scale
    overflowed = None if finite else _cap(mean)
    if overflowed is not None:
        deviations[:, :, overflowed] = 0.0
    variance = np.einsum("crhw,crhw->chw", deviations, deviations, out=empty(of_them.shape))
    _divide(variance, given, deterministic)
    if overflowed is not None:
        variance[:, overflowed] = np.nan
    of_pixels = mean.transpose(1, 2, 0), variance.transpose(1, 2, 0)
    return PixelStatistics(tile, *of_pixels, folded, deviations.transpose(1, 2, 3, 0), given.scale)


@dataclass(frozen=True)
class _Replicates:
    """What the replicates have, before their centre is taken away. Planes of channels, as FoldedSums makes them."""

    values: NDArray[np.float64]
    """(4, replicates, height, width): means times `scale`."""
    centre: NDArray[np.float64]
    """(4, height, width): average of the values of replicates with samples."""
    counts: int | NDArray[np.int64]
    """(height, width): these replicates; one number where all pixels have as many."""
    missing: NDArray[np.bool_] | None
    """(replicates, height, width): which have no sample; None where all have."""
    scale: int


def _replicates_of(folded: FoldedSums, empty: Empty) -> _Replicates:
    """Where all pixels have as many samples in every replicate, their sums are means times that number: nothing is divided."""
    values = folded.planes()
    common = folded.common("taken")
    counts: int | NDArray[np.int64] = len(values[0])
    missing = None
    if not common:
        taken = folded["taken"]
        none = taken == 0
        values /= np.maximum(taken, 1, out=empty(taken.shape))
        if none.any():
            missing, counts = none, len(none) - none.sum(axis=0)
    centre = values.sum(axis=1, out=empty((4, *folded.shape[1:])), initial=0.0)
    if isinstance(counts, int) and counts & (counts - 1) == 0:
        centre *= 1 / counts  # exact, and faster than to divide
    else:
        centre /= np.maximum(counts, 1)
    return _Replicates(values, centre, counts, missing, common or 1)


def _cap(mean: NDArray[Any]) -> NDArray[np.bool_]:
    """Replaces means (4, height, width) that are beyond float32, in place; (height, width): which pixels had any. Samples are
    finite, so that only their float32 sum can be infinite (or, under a filter with negative lobes, NaN)."""
    overflowed: NDArray[np.bool_] = ~np.isfinite(mean).all(axis=0)
    capped = np.nan_to_num(mean[:, overflowed], nan=LARGEST, posinf=LARGEST, neginf=-LARGEST)
    mean[:, overflowed] = capped
    return overflowed


def _divide(squares: NDArray[Any], given: _Replicates, deterministic: bool) -> None:
    """Makes variances of sums of squares (channels, height, width), in place."""
    counts = given.counts
    if isinstance(counts, int) and counts >= 2 and not deterministic:
        squares *= 1 / (counts * (counts - 1) * given.scale**2)
        return
    counts = np.asarray(counts)
    known = (counts >= 2) & (not deterministic)
    squares /= np.where(known, counts * (counts - 1) * float(given.scale) ** 2, np.nan)


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
