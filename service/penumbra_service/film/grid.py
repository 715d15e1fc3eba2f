"""How a window of the full frame is cut into tiles, and tiles into blocks of pixels that statistics pool
over.

All coordinates are pixels of the full frame, x to the right, y down. Tiles lie on a grid that is aligned to
the full frame and are clipped by the window, so that a block's pixels never depend on how large the tiles
are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

FLAG_BLOCK: Final = 8
"""Side of the blocks in which one flagged pixel flags all."""
POOL_BLOCK: Final = 16
"""Side of the blocks over which variance is pooled before it meets a quotient or a decision: one V has a
relative deviation of sqrt(2 / (R - 1)), 256 of them together some 5 % at R = 4."""


@dataclass(frozen=True)
class TileGrid:
    """The tiles of a window. `tile_size` must be a multiple of POOL_BLOCK."""

    window: Tile
    tile_size: int = 64

    def __post_init__(self) -> None:
        if self.tile_size < POOL_BLOCK or self.tile_size % POOL_BLOCK:
            raise ValueError(f"tile_size must be a multiple of {POOL_BLOCK}, not {self.tile_size}")
        if self.window.width < 1 or self.window.height < 1:
            raise ValueError(
                f"a window needs at least one pixel, not {self.window.width} x {self.window.height}"
            )

    @property
    def columns(self) -> range:
        """Grid columns that the window touches."""
        return _cells(self.window.x, self.window.width, self.tile_size)

    @property
    def rows(self) -> range:
        """Grid rows that the window touches."""
        return _cells(self.window.y, self.window.height, self.tile_size)

    def tile(self, column: int, row: int) -> Tile:
        """The part of grid cell (column, row) inside the window."""
        x, width = _clip(column, self.tile_size, self.window.x, self.window.width)
        y, height = _clip(row, self.tile_size, self.window.y, self.window.height)
        return Tile(x, y, width, height)

    def row(self, row: int) -> list[Tile]:
        """The tiles of one grid row, left to right."""
        return [self.tile(column, row) for column in self.columns]

    def __iter__(self) -> Iterator[Tile]:
        for row in self.rows:
            yield from self.row(row)

    def __len__(self) -> int:
        return len(self.columns) * len(self.rows)


def _cells(first: int, count: int, size: int) -> range:
    return range(first // size, (first + count - 1) // size + 1)


def _clip(cell: int, size: int, first: int, count: int) -> tuple[int, int]:
    low = max(cell * size, first)
    return low, min((cell + 1) * size, first + count) - low


def block_starts(first: int, count: int, block: int) -> NDArray[np.intp]:
    """Offsets from `first` at which blocks aligned to the full frame begin; the first is 0. Not to be written to."""
    return _starts(first % block, count, block)


def block_lengths(first: int, count: int, block: int) -> NDArray[np.intp]:
    """Pixels of each of these blocks: less where the ends cut them. Not to be written to."""
    return _lengths(first % block, count, block)


def block_sizes(tile: Tile, block: int) -> NDArray[np.intp]:
    """Pixels of each block of a tile, rows x columns. Not to be written to."""
    return _sizes(tile.y % block, tile.height, tile.x % block, tile.width, block)


@lru_cache(maxsize=1024)
def _starts(beyond: int, count: int, block: int) -> NDArray[np.intp]:
    """`beyond`: pixels of the first block that lie before."""
    return np.array([0, *range(block - beyond, count, block)], np.intp)


@lru_cache(maxsize=1024)
def _lengths(beyond: int, count: int, block: int) -> NDArray[np.intp]:
    return np.diff(_starts(beyond, count, block), append=count)


@lru_cache(maxsize=1024)
def _sizes(above: int, height: int, before: int, width: int, block: int) -> NDArray[np.intp]:
    rows, columns = _lengths(above, height, block), _lengths(before, width, block)
    return np.asarray(np.multiply.outer(rows, columns))
