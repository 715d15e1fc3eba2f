"""What a finished job leaves, and the file names that it is kept under."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

RESULTS: Final[Mapping[str, str]] = {
    "exr": "result.exr",
    "thumbnail": "thumbnail.png",
    "heatmap": "heatmap.png",
    "receipt": "receipt.json",
}

OF_SEQUENCE: Final[Mapping[str, str]] = {"contact_sheet": "contact_sheet.png", "movie": "preview.mp4"}
"""What a job of several frames leaves besides RESULTS of each."""
FRAMES: Final = "frames"
"""The folder in which each frame has one, named by its number."""


def frame_folder(frame: int) -> str:
    """Where a frame's files go, relative to the job's: names sort as numbers do up to 9999."""
    return f"{FRAMES}/{frame:04d}"
