"""All frames of a job on one page: their thumbnails in rows, each with its number below. sRGB code values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from penumbra_service.images.digits import draw_text
from penumbra_service.images.resize import fitted_size, shrink

CELL_SIDE: Final = 160
"""Longest side of a picture on the sheet, in pixels."""
MAX_CELLS: Final = 200
"""Of a longer job, so many frames that lie evenly."""
GAP: Final = 4
LABEL_HEIGHT: Final = 9
ASPECT: Final = 1.5
"""Width over height that the sheet comes near."""
BACKGROUND: Final = np.array([24, 24, 26], np.uint8)
WAITING: Final = np.array([48, 48, 52], np.uint8)
"""Where a frame is not there yet."""


def chosen_frames(frames: Sequence[int]) -> tuple[int, ...]:
    """The frames that a sheet shows: all, or MAX_CELLS that lie evenly, with the first and the last."""
    if len(frames) <= MAX_CELLS:
        return tuple(frames)
    picks = np.rint(np.linspace(0, len(frames) - 1, MAX_CELLS)).astype(int)
    return tuple(frames[i] for i in picks)


def cell_picture(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A thumbnail at its size on the sheet."""
    if max(pixels.shape[:2]) <= CELL_SIDE:
        return pixels
    # Averages of code values, not of light: at this size it is the look that counts.
    small = shrink(pixels.astype(np.float32), CELL_SIDE)
    return np.rint(np.clip(small, 0, 255)).astype(np.uint8)


def columns_of(cells: int, width: int, height: int) -> int:
    """How many stand in a row, for pictures of that size."""
    cell = (height + LABEL_HEIGHT + GAP) / (width + GAP)
    return min(max(round(math.sqrt(cells * ASPECT * cell)), 1), cells)


def contact_sheet(
    frames: Sequence[int], pictures: Mapping[int, NDArray[np.uint8]], size: tuple[int, int]
) -> NDArray[np.uint8]:
    """(height, width, 3). `pictures` by frame, as `cell_picture` makes them; one that is missing leaves a gray
    place. `size`: width and height of the film."""
    width, height = fitted_size(*size, CELL_SIDE)
    columns = columns_of(len(frames), width, height)
    rows = -(-len(frames) // columns)
    step_x, step_y = width + GAP, height + LABEL_HEIGHT + GAP
    sheet = np.empty((rows * step_y + GAP, columns * step_x + GAP, 3), np.uint8)
    sheet[:] = BACKGROUND
    for i, frame in enumerate(frames):
        left, top = GAP + i % columns * step_x, GAP + i // columns * step_y
        cell = sheet[top : top + height, left : left + width]
        cell[:] = WAITING
        picture = pictures.get(frame)
        if picture is not None:
            cell[: picture.shape[0], : picture.shape[1]] = picture[:height, :width]
        label = sheet[top + height : top + height + LABEL_HEIGHT, left : left + width]
        draw_text(label, str(frame), width // 2, 3)
    return sheet
