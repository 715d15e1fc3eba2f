"""A small picture of the render as it stands, kept up to date tile by tile, for thumbnails and noise maps on
the way.

Pixels are averaged over squares whose side is a power of two, aligned to the full frame, so that tiles fill
whole squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film.grid import POOL_BLOCK, block_sizes, block_starts
from penumbra_service.film.statistics import LARGEST, PixelStatistics

MAX_SIDE: Final = 1024
"""Of a preview, in its own pixels, where the window allows (squares are at most POOL_BLOCK wide)."""


@dataclass(frozen=True)
class PreviewImage:
    """A copy that may be handed to other threads."""

    rgba: NDArray[np.float32]
    """(height, width, 4), linear Rec.709; zeros where nothing is rendered yet."""
    variance: NDArray[np.float32]
    """(height, width, 3): of this picture's own pixels' means, NaN where it is not known."""
    scale: int
    """Pixels of the full picture that one pixel's side stands for."""


class Preview:
    """Collects tiles."""

    def __init__(self, window: Tile, max_side: int = MAX_SIDE) -> None:
        self.window = window
        self.scale = 1
        while self.scale < POOL_BLOCK and max(window.width, window.height) > max_side * self.scale:
            self.scale *= 2
        columns = len(block_starts(window.x, window.width, self.scale))
        rows = len(block_starts(window.y, window.height, self.scale))
        self._rgba = np.zeros((4, rows, columns), np.float32)  # planes, as statistics come
        self._variance = np.full((3, rows, columns), np.nan, np.float32)
        self.changed = False

    def put(self, pixels: PixelStatistics) -> None:
        """Replace a tile's part."""
        tile = pixels.tile
        x = tile.x // self.scale - self.window.x // self.scale
        y = tile.y // self.scale - self.window.y // self.scale
        self.changed = True
        mean, variance = pixels.mean.transpose(2, 0, 1), pixels.variance[..., :3].transpose(2, 0, 1)
        if self.scale > 1:
            count = block_sizes(tile, self.scale)
            mean = self._pool(mean, tile) / count
            # Pixels are independent, so the variance of their average is the sum of theirs over the square of
            # their number.
            variance = self._pool(variance, tile) / count**2
        at = np.s_[:, y : y + mean.shape[1], x : x + mean.shape[2]]
        self._rgba[at] = mean
        self._variance[at] = np.minimum(variance, LARGEST)

    def image(self) -> PreviewImage:
        """The picture as it stands; clears `changed`."""
        self.changed = False
        rgba, variance = (np.moveaxis(planes, 0, -1).copy("C") for planes in (self._rgba, self._variance))
        return PreviewImage(rgba, variance, self.scale)

    def _pool(self, planes: NDArray[Any], tile: Tile) -> NDArray[np.float64]:
        rows = np.add.reduceat(planes, block_starts(tile.y, tile.height, self.scale), axis=1)
        result: NDArray[np.float64] = np.add.reduceat(
            rows, block_starts(tile.x, tile.width, self.scale), axis=2
        )
        return result
