"""Where a picture took how many samples: counts as colour, logarithmic from its fewest (dark) to its most (light)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from penumbra_service.images.heatmap import palette
from penumbra_service.images.png import write_png


def sample_map(counts: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """(height, width, 3) sRGB code values; a picture whose pixels all have the same is dark."""
    logs = np.log2(np.maximum(counts, 1).astype(np.float64))
    span = max(float(logs.max() - logs.min()), 1e-9)
    return palette((logs - logs.min()) / span)


def write_sample_map(path: Path, counts: NDArray[np.uint32]) -> None:
    """The same as a PNG file. Raises OSError."""
    text = f"samples a pixel, logarithmic from {counts.min()} (dark) to {counts.max()} (light)"
    write_png(path, sample_map(counts), {"Description": text})
