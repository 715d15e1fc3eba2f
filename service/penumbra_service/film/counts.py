"""Samples and pixels of a picture by what became of them: for receipts, once the picture is there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from penumbra_service.film import flags
from penumbra_service.film.statistics import PixelStatistics


@dataclass
class PixelCounts:
    """Of a tile, or of a whole picture."""

    taken: int = 0
    """Samples that count."""
    lit: int = 0
    """Of these, samples that carried light."""
    rejected: int = 0
    rejected_in: dict[str, int] = field(default_factory=dict)
    """Pixels by name of an effect that their rejected samples had met."""
    pixels: int = 0
    flagged: int = 0
    """Pixels with a bit of flags.UNTRUSTED."""
    flags: dict[str, int] = field(default_factory=dict)
    """Pixels by name of their flag."""
    rays: int = 0
    """Traced by all samples, rejected ones included."""

    def add(self, other: PixelCounts) -> None:
        """Take in those of other pixels."""
        self.taken += other.taken
        self.lit += other.lit
        self.rejected += other.rejected
        self.rejected_in = _sum(self.rejected_in, other.rejected_in)
        self.pixels += other.pixels
        self.flagged += other.flagged
        self.flags = _sum(self.flags, other.flags)
        self.rays += other.rays


def count_pixels(pixels: PixelStatistics, bits: NDArray[np.uint32]) -> PixelCounts:
    """Of a tile; `bits` as pixel_flags gives them."""
    return PixelCounts(
        taken=int(pixels.taken.sum()),
        lit=int(pixels.lit.sum()),
        rejected=int(pixels.rejected.sum()),
        rejected_in=_pixels_with(pixels.rejected_in, flags.EFFECTS),
        pixels=bits.size,
        flagged=count_untrusted(bits),
        flags=_pixels_with(bits, flags.NAMES),
        rays=int(pixels.rays.sum()),
    )


def count_untrusted(bits: NDArray[np.uint32]) -> int:
    """Pixels whose error bar is not to be trusted."""
    return int(np.count_nonzero(bits & flags.UNTRUSTED))


def _pixels_with(bits: NDArray[np.uint32], names: Mapping[str, int]) -> dict[str, int]:
    """How many have each bit. Most have none."""
    any_of = int(np.bitwise_or.reduce(bits, axis=None))
    return {name: int(np.count_nonzero(bits & bit)) if any_of & bit else 0 for name, bit in names.items()}


def _sum(first: Mapping[str, int], second: Mapping[str, int]) -> dict[str, int]:
    total = Counter(first)
    total.update(second)
    return dict(total)
