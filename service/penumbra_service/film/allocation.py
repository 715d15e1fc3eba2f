"""Where an adaptive render spends its samples: from a pilot's statistics to a level for each pixel. Pure.

`error`: n_b ~ (w_b sigma_b^2 / c_b)^(1 / (1 + theta)) minimises the sum of w_b sigma_b^2 n_b^-theta over blocks at a given sum
of c_b n_b (Lagrange). w_b = 1 / (S_b + EPSILON) is what relmse weighs a block's variance with, sigma_b^2 the variance pooled
over the block, c_b the rays that its paths took, counted: the same on every run. A part of all samples stays
uniform, for what the pilot has not seen. Blocks are small, to follow noise closely; a pilot of few samples tells little of one
alone, so that its surroundings have a say in its noise (`smoothed`).

`contrast`: the classic rule (Whitted 1980; Mitchell 1987 measures contrast as here). A pixel takes more samples only where it
differs from a neighbour by more than a threshold.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.allotment import LEVEL_NONE, own_samples
from penumbra_kernels.nodes import Tile

from penumbra_service.film.error import EPSILON, block_sums, pool
from penumbra_service.film.grid import POOL_BLOCK, block_sizes, block_starts
from penumbra_service.film.levels import LevelMap, spread
from penumbra_service.film.predict import THETA_RANGE, Point, predict
from penumbra_service.film.statistics import PixelStatistics
from penumbra_service.film.stop import StopRule

BLOCK: Final = 2
"""Side of the blocks that share a level, pixels. Smaller ones follow noise more closely, and a pilot knows less of each."""
OWN_PART: Final = 0.3
"""Of the standard deviation that decides: what the block's own pilot says; the rest is its surroundings'."""
SURROUNDINGS: Final = (1, 4, 6, 4, 1)
"""Weights of blocks along rows and columns: a binomial, 2 pixels wide (one standard deviation). Modelled on recorded
renders of the four examples of docs/accuracy.md, BLOCK, OWN_PART and this take 0.74 to 0.98 of the seconds that 4 x 4 blocks
on their own did after 16 samples a pixel; own parts of 0.2 to 0.5 and widths of 1.4 to 2.8 pixels are within 3 %."""
PILOT_PART: Final = 1 / 24
"""Of the samples that an even picture is expected to take: a pilot's most, beyond the least that it always has."""
UNIFORM_SHARE: Final = 0.25
"""Of all samples: spread evenly whatever the pilot says."""
MOST: Final = 16.0
"""No block gets more than this times the mean: one block's rare bright sample must not take the picture's budget."""
DARK: Final = 0.01
"""Radiance: differences that are small against it are no contrast."""


@dataclass(frozen=True)
class BlockPilot:
    """What a pilot says of the blocks of a window, rows x columns each."""

    pixels: NDArray[np.float64]
    variance: NDArray[np.float64]
    """Mean over pixels and R G B of the variance of the pixel's mean."""
    weight: NDArray[np.float64]
    """1 / (S + EPSILON), S pooled over POOL_BLOCK as relmse does it."""
    cost: NDArray[np.float64]
    """Rays a path."""


def pilot_of(window: Tile, tiles: Iterable[PixelStatistics]) -> BlockPilot:
    """Pool a pilot's pixels, tile by tile; tiles consist of whole POOL_BLOCK blocks, but for the window's edges."""
    rows = len(block_starts(window.y, window.height, BLOCK))
    columns = len(block_starts(window.x, window.width, BLOCK))
    pixels, variance, weight, rays, paths = (np.zeros((rows, columns)) for _ in range(5))
    for part in tiles:
        tile = part.tile
        y, x = tile.y // BLOCK - window.y // BLOCK, tile.x // BLOCK - window.x // BLOCK
        fine = block_sums(tile, part.mean, part.variance, BLOCK)
        at = np.s_[y : y + fine.pixels.shape[0], x : x + fine.pixels.shape[1]]
        pixels[at], variance[at] = fine.pixels, fine.variance
        weight[at] = _weights(part)
        rays[at] = pool(part.rays, tile, BLOCK)
        paths[at] = pool(part.taken + part.rejected, tile, BLOCK)
    known = np.maximum(pixels, 1)
    return BlockPilot(pixels, variance / known, weight, np.maximum(rays / np.maximum(paths, 1), 1.0))


def _weights(part: PixelStatistics) -> NDArray[np.float64]:
    """Each block's 1 / (S + EPSILON), S of the POOL_BLOCK block that it lies in."""
    pooled = block_sums(part.tile, part.mean, part.variance)
    count = np.maximum(pooled.pixels, 1)
    least = np.square(pooled.mean / count[..., None]).mean(axis=-1)
    weight = 1 / (np.maximum((pooled.square - pooled.variance) / count, least) + EPSILON)
    rows = _parents(part.tile.y, part.tile.height)
    result: NDArray[np.float64] = weight[rows][:, _parents(part.tile.x, part.tile.width)]
    return result


def _parents(first: int, count: int) -> NDArray[np.intp]:
    """For each BLOCK along an edge of a tile, the POOL_BLOCK that it lies in, both counted from the tile's start."""
    starts = block_starts(first, count, BLOCK) + first
    return np.asarray(starts // POOL_BLOCK - first // POOL_BLOCK, np.intp)


def smoothed(pilot: BlockPilot) -> BlockPilot:
    """The same with standard deviations to which the surroundings of each block have their part. Only what decides may be
    smoothed: what is measured would grow where its neighbours are noisier."""
    sigma = np.sqrt(pilot.variance)
    around = _binomial(pilot.pixels * sigma) / np.maximum(_binomial(pilot.pixels), 1)
    return replace(pilot, variance=np.square(OWN_PART * sigma + (1 - OWN_PART) * around))


def _binomial(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over the surroundings by their weights; there is nothing beyond the edges. In a fixed order: the plan must be
    the same on every run."""
    reach = len(SURROUNDINGS) // 2
    for axis in (0, 1):
        n = values.shape[axis]
        wide = np.pad(values, [(reach, reach) if a == axis else (0, 0) for a in (0, 1)])
        parts = [weight * wide.take(range(i, i + n), axis) for i, weight in enumerate(SURROUNDINGS)]
        values = np.sum(parts, axis=0)
    return values


def pilot_suffices(samples: float, seconds: float, goal: StopRule, points: Sequence[Point]) -> bool:
    """Whether twice as many samples a pixel would be more than PILOT_PART of what an even picture is expected to take, by
    whichever rule ends it first; a pilot of which nothing can be told has enough. `points`: the pilot's own."""
    expected = [] if goal.planned is None else [goal.planned]
    if goal.seconds is not None and seconds > 0:
        expected.append(samples * goal.seconds / seconds)
    told = predict(points, goal.relative_error, goal.confidence) if goal.relative_error else None
    if told is not None:
        expected.append(told.samples)
    return not expected or 2 * samples > PILOT_PART * min(expected)


def theta_of(halfway: float, whole: float) -> float:
    """The exponent by which the pilot's mean variance fell from half of its samples to all, within what paths can
    do; the middle of the range where that cannot be told."""
    if not (halfway > 0 and whole > 0 and np.isfinite(halfway) and np.isfinite(whole)):
        return sum(THETA_RANGE) / 2
    return min(max(float(np.log2(halfway / whole)), THETA_RANGE[0]), THETA_RANGE[1])


def densities(pilot: BlockPilot, theta: float) -> NDArray[np.float64]:
    """Samples of a block's pixels over their mean over the picture, rows x columns."""
    need = (pilot.weight * pilot.variance / pilot.cost) ** (1 / (1 + theta))
    mean = float((need * pilot.pixels).sum() / max(pilot.pixels.sum(), 1))
    if mean <= 0:
        return np.ones_like(need)
    shared = UNIFORM_SHARE + (1 - UNIFORM_SHARE) * need / mean
    return np.asarray(np.minimum(shared, MOST))


@dataclass(frozen=True)
class Saving:
    """What an adaptive picture takes beside an even one of the same error."""

    samples: float = 1.0
    """Of its samples a pixel, on average over the picture."""
    cost: float = 1.0
    """Of a sample's seconds: where more are taken, paths may be longer."""

    @property
    def pays(self) -> bool:
        """Whether it takes less than an even one."""
        return self.samples * self.cost < 1

    def __mul__(self, other: Saving) -> Saving:
        """Of both together."""
        return Saving(self.samples * other.samples, self.cost * other.cost)


def saving_of(decided_by: BlockPilot, measured: BlockPilot, theta: float) -> Saving:
    """By the counts that one look at some blocks decides, with the noise that a later look at them has measured:
    sum(w sigma^2 n^-theta) is the same with n = samples * density as with n = 1."""
    density = 2.0 ** -_levels(densities(decided_by, theta))
    density /= float((density * measured.pixels).sum() / measured.pixels.sum())
    noise = measured.pixels * measured.weight * measured.variance
    rays = measured.pixels * measured.cost
    if not noise.sum() > 0:
        return Saving()
    grown = float((noise * density**-theta).sum() / noise.sum())
    return Saving(grown ** (1 / theta), float((rays * density).sum() / rays.sum()))


def spreading_pays(window: Tile, halves: Sequence[Iterable[PixelStatistics]], theta: float) -> bool:
    """Whether a pilot tells that its counts save anything. halves: its tiles by one half of the replicates and by the other;
    each decides what the other measures, since noise that decides would measure its own gain."""
    first, second = (pilot_of(window, half) for half in halves)
    savings = [saving_of(smoothed(a), b, theta) for a, b in ((first, second), (second, first))]
    return sum(saving.samples * saving.cost for saving in savings) < len(savings)


def together(pilots: Sequence[BlockPilot]) -> BlockPilot:
    """The blocks of all, in one row."""
    names = [field.name for field in fields(BlockPilot)]
    return BlockPilot(*(np.concatenate([getattr(p, name).ravel() for p in pilots]) for name in names))


def pilot_samples(even: float, least: float) -> float:
    """Samples a pixel that a pilot takes, where an even picture is expected to take `even` and at least `least` are
    asked for: see pilot_suffices."""
    samples = least
    while 2 * samples <= PILOT_PART * even:
        samples *= 2
    return samples


def _levels(density: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.rint(_wanted(density)))


def _wanted(density: NDArray[np.float64]) -> NDArray[np.float64]:
    """Levels before they are rounded."""
    return np.asarray(np.log2(density.max() / density))


def error_levels(
    window: Tile, pilot: BlockPilot, theta: float, samples: int | None = None, kept: int = 0
) -> NDArray[np.uint8]:
    """(height, width): levels whose densities 2^-level are nearest, in the logarithm, to what the blocks should have.
    `samples` that are planned a replicate beyond the `kept` ones are met by the mean: steps of the axis pass it by up to a
    sample, and so many of the blocks that are nearest to the next level are on that one."""
    wanted = _wanted(densities(smoothed(pilot), theta))
    levels = np.rint(wanted).astype(np.uint8)
    if samples is not None and samples > kept:
        levels += _thinned(window, wanted, levels, samples, kept)
    return spread(levels, window, BLOCK)


def _thinned(
    window: Tile, wanted: NDArray[np.float64], levels: NDArray[np.uint8], samples: int, kept: int
) -> NDArray[np.bool_]:
    """The blocks that go to the next level, so that the mean at some end is as near to `samples` as may be."""
    end = LevelMap(window, spread(levels, window, BLOCK), kept).end_reaching(samples)
    taken = np.array([own_samples(end, level, kept) for level in range(int(levels.max()) + 2)])
    pixels = block_sizes(window, BLOCK)
    beyond = int((taken[levels] * pixels).sum()) - samples * int(pixels.sum())
    order = np.argsort(levels - wanted, axis=None, kind="stable")
    spared = np.cumsum(((taken[levels] - taken[levels + 1]) * pixels).ravel()[order])
    count = int(np.argmin(np.abs(np.concatenate([[0], spared]) - beyond)))
    chosen = np.zeros(levels.size, bool)
    chosen[order[:count]] = True
    return chosen.reshape(levels.shape)


def contrast_levels(rgb: NDArray[Any], threshold: float) -> NDArray[np.uint8]:
    """(height, width): 0 where a pixel of `rgb` (height, width, 3) differs from one of its up to eight neighbours by more
    than the threshold, in R, G or B; LEVEL_NONE elsewhere. Both pixels of such a pair count."""
    refined = np.zeros(rgb.shape[:2], bool)
    for here, there in _pairs():
        a, b = rgb[here], rgb[there]
        differs = (np.abs(a - b) > threshold * (np.abs(a) + np.abs(b) + DARK)).any(axis=-1)
        refined[here] |= differs
        refined[there] |= differs
    return np.where(refined, 0, LEVEL_NONE).astype(np.uint8)


def _pairs() -> tuple[tuple[Any, Any], ...]:
    """Every pair of neighbours once: to the right, below, and along both diagonals."""
    return (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1, :], np.s_[1:, :]),
        (np.s_[:-1, :-1], np.s_[1:, 1:]),
        (np.s_[:-1, 1:], np.s_[1:, :-1]),
    )
