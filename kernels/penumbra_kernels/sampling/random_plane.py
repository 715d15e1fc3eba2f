"""The `random` sampler, x = xi1 W, y = xi2 H: how many of W H points a sample index fall into each pixel.

That is decided without throwing them: the film is halved again and again, and a binomial draw says how many
points go left. Every draw is keyed by (seed, replicate, index, rectangle), so any tile gets the same counts
by itself, and over the film they add up to W H exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, ndtri

from penumbra_kernels.nodes import Tile

Counts = NDArray[np.int64]
Hashes = NDArray[np.uint64]

TABLE_ROWS: Final = (33, 1025)
"""Fair splits of fewer points than this are looked up; the smaller table serves nearly all, from cache."""
BLOCK: Final = 1 << 21
"""Counts worked on at once: bounds the memory."""
SALT: Final = 0x3F84D5B5B5470917
"""Keeps these keys apart from the kernel's."""
_MASK: Final = (1 << 64) - 1
_STEP: Final = 0x9E3779B97F4A7C15


def _mix(x: Hashes) -> Hashes:
    """The finaliser of cl/base/hash.cl."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _combine(key: Hashes, value: Hashes) -> Hashes:
    return _mix(key + np.uint64(_STEP) * (value + np.uint64(1)))


@dataclass(frozen=True)
class _Level:
    """One halving of all rectangles that meet the tile. Indices are into the level's rectangles."""

    split: NDArray[np.intp]
    """Rectangles that are halved; the others are pixels."""
    names: Hashes
    """A number for each of them."""
    left_share: NDArray[np.float64]
    """The first part's share of the area."""
    kept: NDArray[np.intp]
    """Which of (first parts, second parts, pixels), one after the other, meet the tile."""


@dataclass(frozen=True)
class _Plan:
    levels: tuple[_Level, ...]
    pixels: NDArray[np.intp]
    """Where each last rectangle stands in the tile, row by row."""


@lru_cache(maxsize=64)
def _plan(width: int, height: int, tile: Tile) -> _Plan:
    rectangles = np.array([[0, 0, width, height]], np.int64)
    levels = []
    while (rectangles[:, 2:] > 1).any():
        rectangles, level = _halve(rectangles, tile)
        levels.append(level)
    pixels = (rectangles[:, 1] - tile.y) * tile.width + rectangles[:, 0] - tile.x
    return _Plan(tuple(levels), pixels.astype(np.intp))


def _halve(rectangles: Counts, tile: Tile) -> tuple[Counts, _Level]:
    """Split rectangles across their longer side at the largest power of two below: most splits are fair."""
    x, y, w, h = rectangles.T
    splits = w * h > 1
    split = np.flatnonzero(splits)
    x, y, w, h = x[split], y[split], w[split], h[split]
    wide = w >= h
    size = np.where(wide, w, h)
    first = np.left_shift(1, np.frexp((size - 1).astype(np.float64))[1].astype(np.int64) - 1)
    left = np.stack([x, y, np.where(wide, first, w), np.where(wide, h, first)], axis=1)
    right = np.stack(
        [
            np.where(wide, x + first, x),
            np.where(wide, y, y + first),
            np.where(wide, w - first, w),
            np.where(wide, h, h - first),
        ],
        axis=1,
    )
    parts = np.concatenate([left, right, rectangles[~splits]])
    meets = (
        (parts[:, 0] < tile.x + tile.width)
        & (parts[:, 0] + parts[:, 2] > tile.x)
        & (parts[:, 1] < tile.y + tile.height)
        & (parts[:, 1] + parts[:, 3] > tile.y)
    )
    kept = np.flatnonzero(meets)
    corner = (y.astype(np.uint64) << np.uint64(16)) | x.astype(np.uint64)
    extent = (h.astype(np.uint64) << np.uint64(16)) | w.astype(np.uint64)
    names = _mix((corner << np.uint64(32)) | extent)
    return parts[kept], _Level(split, names, first / size, kept)


@lru_cache(maxsize=2)
def _fair_table(rows: int) -> NDArray[np.float64]:
    """n + P(at most k heads in n throws) for k < n, one row after the other: one sorted array for all n."""
    table = np.empty(rows * (rows - 1) // 2)
    chances = np.ones(1)
    for n in range(1, rows):
        chances = 0.5 * (np.append(chances, 0.0) + np.append(0.0, chances))
        table[n * (n - 1) // 2 : n * (n + 1) // 2] = n + np.cumsum(chances)[:-1]
    return table


def _fair_split(n: Counts, u: NDArray[np.float64], rows: int) -> Counts:
    """Inverse CDF of the binomial distribution of n < rows fair throws."""
    at = np.searchsorted(_fair_table(rows), n + u, side="right")
    return np.asarray(np.clip(at - n * (n - 1) // 2, 0, n))


def _split_any(n: Counts, share: NDArray[np.float64], u: NDArray[np.float64]) -> Counts:
    """Inverse CDF of the binomial distribution: a guess by its normal limit, then steps to the exact k."""
    guess = n * share + np.sqrt(n * share * (1.0 - share)) * ndtri(u)
    k: Counts = np.clip(np.round(guess).astype(np.int64), 0, n)
    step = np.ones_like(k)
    while step.any():
        down = (k > 0) & (_at_most(k - 1, n, share) > u)
        up = ~down & (k < n) & (_at_most(k, n, share) <= u)
        step = up.astype(np.int64) - down
        k = k + step
    return k


def _at_most(k: Counts, n: Counts, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """P(at most k of n points), by the regularised incomplete beta function (DLMF 8.17.5)."""
    tail = betainc(np.maximum(n - k, 1), k + 1.0, 1.0 - share)
    return np.asarray(np.where(k >= n, 1.0, tail))


def binomial(n: Counts, share: NDArray[np.float64], u: NDArray[np.float64]) -> Counts:
    """How many of n points go to a part with this share of the area, for u in (0, 1): the inverse CDF."""
    out = np.zeros_like(n)
    fair = share == 0.5
    below = 1  # of no points none go anywhere
    for rows in TABLE_ROWS:
        use = fair & (n >= below) & (n < rows)
        out[use] = _fair_split(n[use], u[use], rows)
        below = rows
    rest = (n > 0) & ~(fair & (n < TABLE_ROWS[-1]))
    out[rest] = _split_any(n[rest], share[rest], u[rest])
    return out


def _descend(plan: _Plan, keys: Hashes, total: int) -> Counts:
    """(keys, pixels of the tile): counts for each key, in the order of the plan's last rectangles."""
    n = np.full((len(keys), 1), total, np.int64)
    for level in plan.levels:
        bits = _combine(keys[:, None], level.names[None, :]) >> np.uint64(11)
        u = (bits.astype(np.float64) + 0.5) * 2.0**-53
        parent = n[:, level.split]
        left = binomial(parent, np.broadcast_to(level.left_share, parent.shape), u)
        whole = np.delete(n, level.split, axis=1)
        n = np.concatenate([left, parent - left, whole], axis=1)[:, level.kept]
    return n


def counts(
    seed: int, width: int, height: int, tile: Tile, replicates: int, first_sample: int, sample_count: int
) -> NDArray[np.uint16]:
    """(replicates, sample_count, tile height, tile width): points in each pixel for each sample index.

    width, height: of the full film, pixels. Over the film the counts of one replicate and index add up to
    width * height; those of different replicates and indices are independent.
    """
    plan = _plan(width, height, tile)
    with np.errstate(over="ignore"):
        start = _mix(np.array([(seed ^ SALT) & _MASK], np.uint64))
        replicate_keys = _combine(start, np.arange(replicates, dtype=np.uint64))
        indices = np.arange(sample_count, dtype=np.uint64) + np.uint64(first_sample)
        keys = _combine(replicate_keys[:, None], indices[None, :]).reshape(-1)
        out = np.empty((len(keys), tile.height * tile.width), np.uint16)
        step = max(BLOCK // out.shape[1], 1)
        for at in range(0, len(keys), step):
            out[at : at + step, plan.pixels] = _descend(plan, keys[at : at + step], width * height)
    return out.reshape(replicates, sample_count, tile.height, tile.width)
