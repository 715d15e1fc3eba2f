"""Blocks of pixels spread over a picture, for what is measured on a part of it. Pure."""

from __future__ import annotations

import math
from typing import Final

from penumbra_kernels.nodes import Tile

BLOCK: Final = 8
"""Side of a block of pixels."""


def _within(cell: int, cells: int, places: int, shift: float) -> int:
    """A place of one of `cells` equal parts of `places`; shift in [0, 1) says which."""
    first, end = cell * places // cells, (cell + 1) * places // cells
    return first + int(shift * (end - first))


def blocks_of(window: Tile, count: int) -> list[Tile]:
    """At most `count` blocks, about, one in each cell of a grid over the window; smaller windows give fewer."""
    columns, rows = max(window.width // BLOCK, 1), max(window.height // BLOCK, 1)
    width, height = min(BLOCK, window.width), min(BLOCK, window.height)
    wide = max(min(columns, count, round(math.sqrt(count * columns / rows))), 1)
    high = max(min(rows, count // wide), 1)
    found = []
    for cell in range(wide * high):
        # Multiples of the golden ratio (Weyl 1916) move the block about in its cell, so that no grid in the scene can hide.
        shift = math.modf(cell * 0.6180339887498949)[0]
        x = _within(cell % wide, wide, columns, shift) * BLOCK
        y = _within(cell // wide, high, rows, 1.0 - shift - 2.0**-30) * BLOCK
        found.append(Tile(window.x + x, window.y + y, width, height))
    return found
