"""Adaptive sampling: how the pixels of a tile share in the job's one axis of sample indices.

Every replicate has one axis of sample indices for all pixels, so that sum nodes and their tree are the same whatever is
decided. A pixel of level j takes the indices below `kept`, and of those from there on the multiples of 2^j: its density is
2^-j of the largest. LEVEL_NONE takes nothing from `kept` on. Indices that a pixel does not take are zeros in its sums, and
are not counted. cl/sampling/share.cl says the same to the device.

An allotment may also change how many shadow rays hits take: in the picture, or, so that a pilot can compare, in half of its
replicates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import CONSTANTS
from penumbra_kernels.nodes import Tile

LEVEL_NONE: Final = CONSTANTS["LEVEL_NONE"]
PILOT_SALT: Final = 0x13198A2E03707344
"""Keeps a pilot's random numbers apart from those of the picture of the same seed."""
_MASK: Final = (1 << 64) - 1
_STEP: Final = 0x9E3779B97F4A7C15

ShadowRays = tuple[int, int]
"""What stands for the scene's `shadow_rays` in the first half of the replicates, and in the second; 0: those themselves."""
AS_GIVEN: Final[ShadowRays] = (0, 0)


@dataclass(frozen=True, eq=False)
class Allotment:
    """What a tile's pixels take of the axis."""

    levels: NDArray[np.uint8]
    """(height, width) of the tile."""
    kept: int = 0
    """Indices of each replicate that every pixel takes: 0 or a power of two."""
    planned: int = 0
    """Indices of each replicate that are planned in all: strata are made for them; 0: unknown, strata double."""
    pilot: bool = False
    """Samples that only decide: they have random numbers of their own."""
    kept_planned: int | None = None
    """What `planned` was while the kept ones were taken; None: those themselves."""
    shadow_rays: ShadowRays = AS_GIVEN
    kept_shadow_rays: ShadowRays = AS_GIVEN
    """While the kept ones were taken."""

    def shadow_rays_at(self, index: int) -> ShadowRays:
        """Of a sample index."""
        return self.kept_shadow_rays if index < self.kept else self.shadow_rays

    def samples(self, first: int, count: int) -> dict[int, int]:
        """Pixels by how many of [first, first + count) they take."""
        taken: dict[int, int] = {}
        pixels = np.bincount(self.levels.ravel())
        for level in np.flatnonzero(pixels):
            own = own_samples(first + count, int(level), self.kept) - own_samples(
                first, int(level), self.kept
            )
            taken[own] = taken.get(own, 0) + int(pixels[level])
        return taken


def even(
    tile: Tile, planned: int = 0, *, pilot: bool = False, shadow_rays: ShadowRays = AS_GIVEN
) -> Allotment:
    """Every pixel takes every index."""
    levels = np.zeros((tile.height, tile.width), np.uint8)
    return Allotment(levels, 0, planned, pilot, shadow_rays=shadow_rays)


def halves(replicates: int) -> tuple[slice, slice]:
    """The replicates that count as the first half, and as the second."""
    return slice(replicates // 2), slice(replicates // 2, replicates)


def own_samples(end: int, level: int, kept: int) -> int:
    """Of the indices below `end`, how many a pixel of this level takes."""
    if end <= kept:
        return end
    if level == LEVEL_NONE:
        return kept
    ahead = (1 << level) - 1
    return kept + (end + ahead >> level) - (kept + ahead >> level)


def pilot_seed(seed: int) -> int:
    """The seed of a pilot: a bijection of the picture's, so that two pictures never share one."""
    x = (seed ^ PILOT_SALT) + _STEP & _MASK
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 & _MASK
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB & _MASK
    return x ^ (x >> 31)
