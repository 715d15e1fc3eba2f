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
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film import flags
from penumbra_service.film.grid import POOL_BLOCK, block_starts
from penumbra_service.film.statistics import PixelStatistics

EPSILON: Final = 0.01
"""Keeps dark blocks from asking for an error that nobody sees; in squared radiance."""
FEW_CARRIERS: Final = 25
"""Pixels: an error that fewer carry (in small pictures, a hundredth of the pixels) is uncertain by a fifth and more from their
number alone; rare bright samples make it, and more samples meet brighter ones. After pilots at 96 x 72, 2 to 23 carry that of
the example with all effects, whose light is met through glass by chance; 28 to 2,500 carry those of the others."""


@dataclass(frozen=True)
class BlockSums:
    """Sums over the pixels of each block of a tile, as float64 rows x columns."""

    pixels: NDArray[np.float64]
    """Pixels whose variance is known; the sums below are over these alone."""
    variance: NDArray[np.float64]
    """Of V over pixels and R G B, divided by 3."""
    square: NDArray[np.float64]
    """Of m^2, likewise."""
    mean: NDArray[np.float64]
    """Of m, for R G B apart: rows x columns x 3."""
    squared_variance: NDArray[np.float64]
    """Of the square of what `variance` sums."""


@dataclass(frozen=True)
class TileSummary:
    """What the picture's error needs of one tile at one number of samples."""

    blocks: BlockSums
    all_pixels: int
    untrusted: int
    """Pixels with a bit of flags.UNTRUSTED."""
    flagged: dict[str, int]
    """Pixels by name of the flag."""
    taken: int
    lit: int
    rejected: int
    rejected_in: dict[str, int]
    """Pixels by name of an effect that their rejected samples had met."""
    rays: int
    """Traced by all samples."""
    maximum: float
    """Largest mean of R, G or B."""


def block_sums(pixels: PixelStatistics, block: int = POOL_BLOCK) -> BlockSums:
    """Pool a tile over blocks of this side. Blocks are aligned to the full frame, so they do not depend on the tiles."""
    known = np.isfinite(pixels.variance[..., 0])
    red, green, blue = (pixels.mean[..., i] for i in range(3))
    planes = np.empty((7, *known.shape))
    planes[0] = known
    planes[1] = (pixels.variance[..., 0] + pixels.variance[..., 1] + pixels.variance[..., 2]) / 3
    planes[2] = (np.square(red) + np.square(green) + np.square(blue)) / 3
    planes[3:6] = red, green, blue
    np.square(planes[1], out=planes[6])
    if not known.all():
        planes[:, ~known] = 0.0
    pooled = _pool_planes(planes, pixels.tile, block)
    return BlockSums(pooled[0], pooled[1], pooled[2], np.moveaxis(pooled[3:6], 0, -1), pooled[6])


def pool(values: NDArray[Any], tile: Tile, block: int) -> NDArray[np.float64]:
    """Sums of a tile's pixels (height, width, ...) over blocks of this side, aligned to the full frame."""
    pooled: NDArray[np.float64] = _pool_planes(values[None].astype(np.float64), tile, block)[0]
    return pooled


def _pool_planes(planes: NDArray[np.float64], tile: Tile, block: int) -> NDArray[np.float64]:
    """The same of several planes (planes, height, width, ...) at once."""
    rows = np.add.reduceat(planes, block_starts(tile.y, tile.height, block), axis=1)
    result: NDArray[np.float64] = np.add.reduceat(rows, block_starts(tile.x, tile.width, block), axis=2)
    return result


def summarize(pixels: PixelStatistics, bits: NDArray[np.uint32]) -> TileSummary:
    """A tile's share in the picture's error; `bits` as pixel_flags gives them."""
    return TileSummary(
        blocks=block_sums(pixels),
        all_pixels=bits.size,
        untrusted=int(np.count_nonzero(bits & flags.UNTRUSTED)),
        flagged=_pixels_with(bits, flags.NAMES),
        taken=int(pixels.taken.sum()),
        lit=int(pixels.lit.sum()),
        rejected=int(pixels.rejected.sum()),
        rejected_in=_pixels_with(pixels.rejected_in, flags.EFFECTS),
        rays=int(pixels.rays.sum()),
        maximum=float(pixels.mean[..., :3].max(initial=0.0)),
    )


def _pixels_with(bits: NDArray[np.uint32], names: Mapping[str, int]) -> dict[str, int]:
    """How many have each bit. Most have none."""
    any_of = int(np.bitwise_or.reduce(bits, axis=None))
    return {name: int(np.count_nonzero(bits & bit)) if any_of & bit else 0 for name, bit in names.items()}


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
    pixels = np.concatenate([s.blocks.pixels.ravel() for s in summaries])
    variance = np.concatenate([s.blocks.variance.ravel() for s in summaries])
    square = np.concatenate([s.blocks.square.ravel() for s in summaries])
    mean = np.concatenate([s.blocks.mean.reshape(-1, 3) for s in summaries])
    squared = np.concatenate([s.blocks.squared_variance.ravel() for s in summaries])
    has = pixels > 0
    count, variance, square, mean, squared = (a[has] for a in (pixels, variance, square, mean, squared))
    total = float(count.sum())
    if total == 0:
        return ImageError(math.nan, math.nan, math.nan, math.nan, 0)
    least = np.square(mean / count[:, None]).mean(axis=1)
    signal = np.maximum((square - variance) / count, least) + EPSILON
    quotient = (variance / count) / signal
    relmse = math.fsum(count * quotient) / total
    mse = math.fsum(variance) / total
    maximum = max(s.maximum for s in summaries)
    return ImageError(
        relmse,
        _deviation(count / total, quotient, relmse),
        mse,
        _psnr(mse, maximum),
        int(total),
        _carriers(variance / signal, squared / signal**2),
    )


def _carriers(parts: NDArray[Any], squared: NDArray[Any]) -> float:
    """Of each block's sums of pixels' parts in the error, and of their squares."""
    of_squares = math.fsum(squared)
    return math.fsum(parts) ** 2 / of_squares if of_squares > 0 else math.nan


def _deviation(weights: NDArray[Any], quotient: NDArray[Any], mean: float) -> float:
    """Relative standard deviation of the weighted mean of n blocks: sqrt(n/(n-1) sum w^2 (q - mean)^2) /
    mean. Blocks differ by what they show as well as by chance, so that this errs on the safe side."""
    n = len(quotient)
    if mean == 0.0:
        return 0.0
    if n < 2:
        return 1.0
    return math.sqrt(n / (n - 1) * math.fsum((weights * (quotient - mean)) ** 2)) / mean


def _psnr(mse: float, maximum: float) -> float:
    if mse == 0.0:
        return math.inf
    return 10 * math.log10(maximum * maximum / mse) if maximum > 0 else math.nan
