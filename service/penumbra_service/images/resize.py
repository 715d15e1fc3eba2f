"""Smaller pictures by area: each new pixel is the average of exactly the part of the old picture that it
covers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def fitted_size(width: int, height: int, max_side: int) -> tuple[int, int]:
    """Width and height, in proportion, with no side above `max_side`; never larger than given, at least 1
    x 1."""
    scale = min(1.0, max_side / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def shrink(pixels: NDArray[np.float32], max_side: int) -> NDArray[np.float32]:
    """(height, width, channels), no side above `max_side`."""
    height, width, channels = pixels.shape
    new_width, new_height = fitted_size(width, height, max_side)
    if (new_width, new_height) == (width, height):
        return pixels
    rows = _averages(pixels.reshape(height, width * channels), new_height)
    columns = rows.reshape(new_height, width, channels).transpose(1, 0, 2)
    shrunk = _averages(columns.reshape(width, new_height * channels), new_width)
    return np.ascontiguousarray(
        shrunk.reshape(new_width, new_height, channels).transpose(1, 0, 2), np.float32
    )


def _averages(cells: NDArray[np.float32], new: int) -> NDArray[np.float32]:
    """(new, n): averages over equal stretches of the first axis of cells (old, n), parts of cells counted as parts."""
    old = len(cells)
    step = old / new
    start = np.arange(new) * step
    end = np.minimum(start + step, old)
    first = start.astype(np.int64)
    out = np.zeros((new, *cells.shape[1:]), np.float32)
    for tap in range(math.ceil(step) + 1):
        cell = first + tap
        share = (np.minimum(end, cell + 1) - np.maximum(start, cell)) / step
        inside = np.flatnonzero((share > 0) & (cell < old))
        out[inside] += share[inside, None].astype(np.float32) * cells[cell[inside]]
    return out
