"""The error of a picture, without a reference: pooled variance against pooled signal, block by block.

relmse of a block = mean V / (S + EPSILON), pooled over its pixels and R G B; of the picture, the mean over
blocks by pixels. `relative error` is its square root. S estimates the mean of the true values' squares: mean
m^2 - mean V is unbiased for it, and the square of the block's mean can only be less (Jensen), so S is the
larger of the two: the difference alone is near 0 by chance where few samples bring all the light. The plain
per-pixel quotient reads half the truth at 64 samples, since V and m^2 of one pixel err together: hence the
pooling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film.grid import POOL_BLOCK, block_sizes, block_starts
from penumbra_service.film.scratch import Empty
from penumbra_service.film.statistics import PixelStatistics

EPSILON: Final = 0.01
"""Keeps dark blocks from asking for an error that nobody sees; in squared radiance."""
FEW_CARRIERS: Final = 25
"""Pixels: an error that fewer carry (in small pictures, a hundredth of the pixels) is uncertain by a fifth and more from their
number alone; rare bright samples make it, and more samples meet brighter ones. After pilots at 96 x 72, 2 to 23 carry that of
the example with all effects, whose light is met through glass by chance; 28 to 2,500 carry those of the others."""


@dataclass(frozen=True)
class BlockSums:
    """Sums over the pixels of each block of a tile, rows x columns."""

    table: NDArray[np.float64]
    """(7, rows, columns): the planes below, those of `mean` one after the other."""

    @property
    def pixels(self) -> NDArray[np.float64]:
        """Pixels whose variance is known; the sums below are over these alone."""
        pixels: NDArray[np.float64] = self.table[0]
        return pixels

    @property
    def variance(self) -> NDArray[np.float64]:
        """Of V over pixels and R G B, divided by 3."""
        variance: NDArray[np.float64] = self.table[1]
        return variance

    @property
    def square(self) -> NDArray[np.float64]:
        """Of m^2, likewise."""
        square: NDArray[np.float64] = self.table[2]
        return square

    @property
    def squared_variance(self) -> NDArray[np.float64]:
        """Of the square of what `variance` sums."""
        squared: NDArray[np.float64] = self.table[3]
        return squared

    @property
    def mean(self) -> NDArray[np.float64]:
        """Of m, for R G B apart: rows x columns x 3."""
        return self.table[4:].transpose(1, 2, 0)


_DIVISORS: Final = np.array([3.0, 3.0, 9.0, 1.0, 1.0, 1.0])[:, None, None]
"""Of the planes of BlockSums from the second on: R G B are averaged."""


@dataclass(frozen=True)
class TileSummary:
    """What a look at the picture's error needs of one tile at one number of samples."""

    blocks: BlockSums
    all_pixels: int
    taken: int
    """Samples that count."""
    rejected: int
    maximum: float
    """Largest mean of R, G or B."""


def summarize(pixels: PixelStatistics, empty: Empty = np.empty) -> TileSummary:
    """A tile's share in the picture's error; `empty` makes arrays that are needed on the way."""
    return TileSummary(
        blocks=block_sums(pixels.tile, pixels.mean, pixels.variance, empty=empty),
        all_pixels=pixels.tile.width * pixels.tile.height,
        taken=pixels.sums.total("taken"),
        rejected=pixels.sums.total("rejected"),
        maximum=float(pixels.mean[..., :3].max(initial=0.0)),
    )


def block_sums(
    tile: Tile,
    mean: NDArray[np.float64],
    variance: NDArray[np.float64],
    block: int = POOL_BLOCK,
    *,
    empty: Empty = np.empty,
) -> BlockSums:
    """Pool a tile's pixels (height, width, 3 or more) over blocks of this side. Blocks are aligned to the full frame, so
    that they do not depend on the tiles."""
    rgb, v = mean[..., :3].transpose(2, 0, 1), variance[..., :3].transpose(2, 0, 1)
    planes = empty((6, *v.shape[1:]))
    v.sum(axis=0, out=planes[0])
    np.square(rgb, out=planes[3:]).sum(axis=0, out=planes[1])
    np.square(planes[0], out=planes[2])
    planes[3:] = rgb
    count: NDArray[Any] = block_sizes(tile, block)
    pooled = _pool_planes(planes, tile, block)
    if not math.isfinite(pooled[0].sum()):
        known = np.isfinite(v[0])
        planes[:, ~known] = 0.0
        pooled, count = _pool_planes(planes, tile, block), pool(known, tile, block)
    table = np.empty((7, *count.shape))
    table[0] = count
    np.divide(pooled, _DIVISORS, out=table[1:])
    return BlockSums(table)


def pool(values: NDArray[Any], tile: Tile, block: int) -> NDArray[np.float64]:
    """Sums of a tile's pixels (height, width, ...) over blocks of this side, aligned to the full frame."""
    pooled: NDArray[np.float64] = _pool_planes(values[None].astype(np.float64), tile, block)[0]
    return pooled


def _pool_planes(planes: NDArray[np.float64], tile: Tile, block: int) -> NDArray[np.float64]:
    """The same of several planes (planes, height, width, ...) at once."""
    rows = np.add.reduceat(planes, block_starts(tile.y, tile.height, block), axis=1)
    result: NDArray[np.float64] = np.add.reduceat(rows, block_starts(tile.x, tile.width, block), axis=2)
    return result


@dataclass(frozen=True)
class ImageError:
    """The error of a whole picture. Fields are NaN where no pixel's variance is known."""

    relmse: float
    deviation: float
    """Relative standard deviation of `relmse`, from its spread over blocks."""
    mse: float
    """Mean of V over pixels and R G B."""
    psnr: float
    """dB, against the largest mean in the picture."""
    pixels: int
    """Pixels whose variance is known."""
    carriers: float = math.nan
    """How many pixels carry the error: (sum e)^2 / sum e^2 of their parts e in it; all where these are equal, one where one
    has it all."""
    floor: float = 0.0
    """The share of EPSILON in what variances are divided by, over blocks by their parts in the error: relative to the
    picture's own brightness alone, relmse is 1 / (1 - floor) times as large, or more."""

    @property
    def known(self) -> bool:
        return self.pixels > 0

    @property
    def of_few(self) -> bool:
        """Whether so few pixels carry the error that what a lower one will take has no upper bound."""
        return self.carriers < min(FEW_CARRIERS, self.pixels / 100)

    @property
    def relative_error(self) -> float:
        """sqrt(relmse)."""
        return math.sqrt(self.relmse) if self.known else math.nan

    def upper(self, confidence: float) -> float:
        """relmse with its allowance: what a stop rule compares with target^2."""
        return self.relmse * (1 + normal_quantile(confidence) * self.deviation)

    def relative_interval(self, confidence: float) -> tuple[float, float]:
        """The relative error's interval."""
        if not self.known:
            return math.nan, math.nan
        low = self.relmse * max(1 - normal_quantile(confidence) * self.deviation, 0.0)
        return math.sqrt(low), math.sqrt(self.upper(confidence))


def normal_quantile(confidence: float) -> float:
    """Two-sided: 1.96 for 0.95."""
    return NormalDist().inv_cdf((1 + confidence) / 2)


def image_error(summaries: list[TileSummary]) -> ImageError:
    """Of a window, from its tiles. The sum is exactly rounded (math.fsum), so neither their order nor their
    size counts."""
    table = np.concatenate([s.blocks.table.reshape(7, -1) for s in summaries], axis=1)
    if not table[0].all():
        table = table[:, table[0] > 0]
    count, variance, square, squared = table[:4]
    total = float(count.sum())
    if total == 0:
        return ImageError(math.nan, math.nan, math.nan, math.nan, 0)
    least = np.square(table[4:] / count).sum(axis=0) / 3
    signal = np.maximum((square - variance) / count, least) + EPSILON
    quotient = (variance / count) / signal
    parts = count * quotient
    sum_of_parts = _sum(parts)
    relmse = sum_of_parts / total
    mse = _sum(variance) / total
    maximum = max(s.maximum for s in summaries)
    return ImageError(
        relmse,
        _deviation(count / total, quotient, relmse),
        mse,
        _psnr(mse, maximum),
        int(total),
        _carriers(variance / signal, squared / signal**2),
        _sum(parts * (EPSILON / signal)) / sum_of_parts if sum_of_parts > 0 else 0.0,
    )


def _sum(values: NDArray[Any]) -> float:
    """Exactly rounded, whatever the order."""
    return math.fsum(values.tolist())


def _carriers(parts: NDArray[Any], squared: NDArray[Any]) -> float:
    """Of each block's sums of pixels' parts in the error, and of their squares."""
    of_squares = _sum(squared)
    return _sum(parts) ** 2 / of_squares if of_squares > 0 else math.nan


def _deviation(weights: NDArray[Any], quotient: NDArray[Any], mean: float) -> float:
    """Relative standard deviation of the weighted mean of n blocks: sqrt(n/(n-1) sum w^2 (q - mean)^2) /
    mean. Blocks differ by what they show as well as by chance, so that this errs on the safe side."""
    n = len(quotient)
    if mean == 0.0:
        return 0.0
    if n < 2:
        return 1.0
    return math.sqrt(n / (n - 1) * _sum((weights * (quotient - mean)) ** 2)) / mean


def _psnr(mse: float, maximum: float) -> float:
    if mse == 0.0:
        return math.inf
    return 10 * math.log10(maximum * maximum / mse) if maximum > 0 else math.nan
