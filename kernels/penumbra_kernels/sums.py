"""What a sum node holds of each pixel and replicate, in planes: an array for each channel and each count.

Adding nodes up and looking at them goes through one channel after the other; out of records of a pixel's nine numbers
numpy reads a column several times as slowly as a plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import CONSTANTS

CHANNELS: Final = 4
COUNTS: Final = ("taken", "lit", "rejected", "rejected_in")
"""By their planes: samples that count, zeros included; of these, samples that carried light; NaN, infinite or negative ones;
bits of the effects in which rejected samples arose (base/effects.h)."""
NAMES: Final = ("rgba", *COUNTS, "rays")
NARROW_BYTES: Final = 4 * CONSTANTS["SUM_PLANES"]
"""Of one pixel and replicate."""
WIDE_BYTES: Final = NARROW_BYTES + 4 * (CHANNELS + 1)


@dataclass(frozen=True, eq=False)
class Sums:
    """Of a tile's pixels and every replicate. `sums[name]` is a field by pixel: rgba (replicates, height, width, 4), the others
    (replicates, height, width), to be read and written. `sums[slices]` are those of some replicates, rows and columns."""

    planes: NDArray[Any]
    """(4, replicates, height, width), float32 or float64: R G B A of the samples that count."""
    counts: NDArray[np.uint32]
    """(4, replicates, height, width): COUNTS."""
    rays: NDArray[Any]
    """(replicates, height, width), uint32 or uint64: traced by all samples, rejected ones included: what they cost, counted."""
    _common: dict[str, int | None] = field(default_factory=dict, repr=False)

    @property
    def wide(self) -> bool:
        """Whether colour has 64 bits, and rays have."""
        return self.planes.dtype == np.float64

    @property
    def shape(self) -> tuple[int, int, int]:
        """(replicates, height, width)."""
        replicates, height, width = self.rays.shape
        return replicates, height, width

    @property
    def size(self) -> int:
        """Pixels times replicates."""
        return self.rays.size

    @property
    def nbytes(self) -> int:
        return self.planes.nbytes + self.counts.nbytes + self.rays.nbytes

    def __getitem__(self, what: Any) -> Any:
        if not isinstance(what, str):
            at = (slice(None), *(what if isinstance(what, tuple) else (what,)))
            return Sums(self.planes[at], self.counts[at], self.rays[what])
        if what == "rgba":
            return self.planes.transpose(1, 2, 3, 0)
        return self.rays if what == "rays" else self.counts[COUNTS.index(what)]

    def __setitem__(self, name: str, values: Any) -> None:
        self[name][...] = values

    def tobytes(self) -> bytes:
        """The same for the same bits."""
        return self.planes.tobytes() + self.counts.tobytes() + self.rays.tobytes()

    def common(self, name: str) -> int | None:
        """The count that every pixel has in every replicate, None where they differ. It is kept: the count is not to be written
        after that."""
        if name not in self._common:
            plane = self[name]
            most = int(plane.max())
            self._common[name] = most if most == 0 or plane.min() == most else None
        return self._common[name]

    def total(self, name: str) -> int:
        """A count over all pixels and replicates."""
        common = self.common(name)
        return int(self[name].sum(dtype=np.uint64)) if common is None else common * math.prod(self.shape)

    def plus(self, other: Sums, *, wide: bool) -> Sums:
        """Both together, in float64 and 64 bits of rays with `wide`."""
        total = empty_sums(self.shape, wide=wide)
        np.add(self.planes, other.planes, out=total.planes, dtype=total.planes.dtype)
        added, met = COUNTS.index("rejected_in"), total.counts
        np.add(self.counts[:added], other.counts[:added], out=met[:added])
        np.bitwise_or(self.counts[added], other.counts[added], out=met[added])
        np.add(self.rays, other.rays, out=total.rays, dtype=total.rays.dtype)
        for name, ours in self._common.items():
            theirs = other._common.get(name)
            if ours is not None and theirs is not None:
                total._common[name] = ours + theirs
        return total


def stride_of(entries: int) -> int:
    """Words from one plane of `entries` to the next, as a kernel writes them. Tiles of 64 or 96 pixels have planes of whole
    4 KiB: an entry's numbers, and its replicates', would all fall into one set of a cache, and throw each other out. So
    planes are seven lines of 64 bytes more than that apart."""
    return -(-entries // 1024) * 1024 + 112


def of_words(words: NDArray[np.uint32]) -> Sums:
    """Of (SUM_PLANES, replicates, height, width): the planes that a kernel writes, without what lies between."""
    rays = CHANNELS + len(COUNTS)
    return Sums(words[:CHANNELS].view(np.float32), words[CHANNELS:rays], words[rays])


def of_replicates(parts: Sequence[Sums]) -> Sums:
    """All replicates of these, in this order."""
    planes, counts = (
        np.concatenate(arrays, axis=1) for arrays in zip(*((p.planes, p.counts) for p in parts), strict=True)
    )
    return Sums(planes, counts, np.concatenate([part.rays for part in parts]))


def empty_sums(shape: tuple[int, int, int], *, wide: bool = False) -> Sums:
    """Of (replicates, height, width), their values not set."""
    if not wide:
        return of_words(np.empty((CONSTANTS["SUM_PLANES"], *shape), np.uint32))
    planes, counts = np.empty((CHANNELS, *shape), np.float64), np.empty((len(COUNTS), *shape), np.uint32)
    return Sums(planes, counts, np.empty(shape, np.uint64))


def no_sums(shape: tuple[int, int, int], *, wide: bool = False) -> Sums:
    """Of (replicates, height, width): no sample."""
    sums = empty_sums(shape, wide=wide)
    for array in (sums.planes, sums.counts, sums.rays):
        array[...] = 0
    return sums
