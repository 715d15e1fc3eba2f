"""Which part of a picture a pilot renders, and what its blocks say of the error of the whole.

Blocks are those over which the picture's error is pooled (grid.POOL_BLOCK): a quotient that is pooled over blocks of
another size is another number. The choice is stratified along a Z-order curve, so that it is spread over the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from penumbra_kernels.nodes import Tile

from penumbra_service.film.error import TileSummary, image_error, normal_quantile
from penumbra_service.film.grid import POOL_BLOCK, TileGrid
from penumbra_service.film.predict import Point, point_of

MOST_PIXELS: Final = 32_000
"""About what two seconds take to 128 samples a pixel on two cores."""
LEAST_SAMPLES: Final = 16
"""A pixel: of the first round."""
ROUNDS: Final = 4
"""Each doubles the samples: 16, 32, 64, 128."""
MOST_SAMPLES: Final = 16_384
"""A pixel: of a picture of a few pixels, whose rounds take no time."""


def blocks_of(window: Tile) -> list[Tile]:
    """All blocks of a window along a Z-order curve, clipped to it."""
    grid = TileGrid(window, POOL_BLOCK)
    cells = [(column, row) for row in grid.rows for column in grid.columns]
    return [grid.tile(*cell) for cell in sorted(cells, key=lambda cell: _interleave(*cell))]


def _interleave(column: int, row: int) -> int:
    """The bits of both numbers, alternating: the place on the Z-order curve."""
    return sum(
        ((column >> i & 1) | (row >> i & 1) << 1) << 2 * i for i in range(max(column, row).bit_length())
    )


def choose_blocks(blocks: Sequence[Tile], count: int, seed: int) -> list[Tile]:
    """`count` of them at equal steps from a random start (systematic sampling); all where there are no more."""
    if count >= len(blocks):
        return list(blocks)
    places = (np.arange(count) + np.random.default_rng(seed).random()) * (len(blocks) / count)
    return [blocks[int(place)] for place in places]


def most_blocks(pixels: int = MOST_PIXELS) -> int:
    """Blocks that have about so many pixels."""
    return max(pixels // POOL_BLOCK**2, 1)


def round_ends(replicates: int) -> list[int]:
    """Samples a replicate at the end of each round."""
    first = max(LEAST_SAMPLES // replicates, 1)
    return [first << i for i in range(ROUNDS)]


def most_samples(replicates: int) -> int:
    """Samples a replicate at the end of the last round that any pilot takes: a first one's, doubled."""
    return round_ends(replicates)[0] * (MOST_SAMPLES // LEAST_SAMPLES)


def affordable(
    rate: float, seconds: float, replicates: int, ends: Sequence[int], most: int
) -> tuple[int, int]:
    """(blocks, rounds) for so many seconds at `rate` samples a second: as many rounds as a quarter of the blocks
    allows, since theta is told by the span of samples, then as many blocks as there is time for."""
    for rounds in range(len(ends), 0, -1):
        count = int(rate * seconds / (POOL_BLOCK**2 * replicates * ends[rounds - 1]))
        if count >= max(most // 4, 1):
            return min(count, most), rounds
    return max(min(count, most), 1), 1


def pilot_point(
    summaries: list[TileSummary], samples: int, seconds: float, all_blocks: int, confidence: float
) -> Point:
    """The picture's error as the pilot's blocks estimate it, after `samples` a pixel.

    Its deviation is that of the pilot. The allowance of the stop rule is that which the whole picture will have, whose
    blocks are more.
    """
    error = image_error(summaries)
    if not error.known:
        return Point(samples, seconds, math.nan, math.nan)
    of_picture = error.deviation * math.sqrt(min(len(summaries) / all_blocks, 1.0))
    upper = error.relmse * (1 + normal_quantile(confidence) * of_picture)
    return point_of(samples, seconds, error, upper)
