"""Smaller pictures by area: each new pixel is the average of exactly the part of the old picture that it
covers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


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
    rows = _coverage(height, new_height) @ pixels.reshape(height, width * channels)
    columns = (
        rows.reshape(new_height, width, channels).transpose(1, 0, 2).reshape(width, new_height * channels)
    )
    shrunk = (_coverage(width, new_width) @ columns).reshape(new_width, new_height, channels)
    return np.ascontiguousarray(shrunk.transpose(1, 0, 2), np.float32)


def _coverage(old: int, new: int) -> Any:
    """(new, old): the share of each old cell in each new one; rows sum to 1."""
    step = old / new
    weights = sparse.lil_matrix((new, old), dtype=np.float32)
    for i in range(new):
        start, end = i * step, min((i + 1) * step, old)
        for cell in range(int(start), min(math.ceil(end), old)):
            weights[i, cell] = (min(end, cell + 1) - max(start, cell)) / step
    return weights.tocsr()
