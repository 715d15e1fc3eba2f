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
