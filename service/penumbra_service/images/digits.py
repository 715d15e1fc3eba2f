"""Just enough lettering for a scale: digits, point and percent sign, 3 x 5 pixels each."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

WIDTH: Final = 4
"""Of a letter and the gap after it."""
MARGIN: Final = 4
"""Columns that stay free at the edges, which a frame's round corners may hide."""
_ROWS: Final = {
    "0": ("###", "# #", "# #", "# #", "###"),
    "1": (" # ", "## ", " # ", " # ", "###"),
    "2": ("###", "  #", "###", "#  ", "###"),
    "3": ("###", "  #", "###", "  #", "###"),
    "4": ("# #", "# #", "###", "  #", "  #"),
    "5": ("###", "#  ", "###", "  #", "###"),
    "6": ("###", "#  ", "###", "# #", "###"),
    "7": ("###", "  #", "  #", "  #", "  #"),
    "8": ("###", "# #", "###", "# #", "###"),
    "9": ("###", "# #", "###", "  #", "###"),
    ".": ("   ", "   ", "   ", "   ", " # "),
    "%": ("# #", "  #", " # ", "#  ", "# #"),
}


def draw_text(pixels: NDArray[np.uint8], text: str, center: int, top: int) -> None:
    """Draws in white around column `center`, moved so that it stays MARGIN inside."""
    width = len(text) * WIDTH - 1
    left = max(MARGIN, min(center - width // 2, pixels.shape[1] - width - MARGIN))
    for i, letter in enumerate(text):
        for y, row in enumerate(_ROWS[letter]):
            for x, mark in enumerate(row):
                if mark == "#" and left + i * WIDTH + x < pixels.shape[1]:
                    pixels[top + y, left + i * WIDTH + x] = 255
