"""Sum nodes and the one rule by which they are added, so that any split into leases gives the same bits.

A node holds, for a tile and every replicate, sums over the aligned power-of-two range of sample indices
[first_sample, first_sample + sample_count). Its parent is the sum of its two children in index order: in float32 up to
FLOAT32_SAMPLES samples (as the kernel does it), in float64 beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import LAYERS
from penumbra_kernels.sums import Sums, no_sums, of_replicates

FLOAT32_SAMPLES: Final = 256
"""Largest node whose sums are float32; a launch never covers more samples of one pixel and replicate."""


@dataclass(frozen=True)
class Tile:
    """A rectangle of pixels of the full frame."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True)
class SumNode:
    """Sums over one range of sample indices."""

    tile: Tile
    first_sample: int
    sample_count: int
    sums: Sums
    """Of every replicate; wide beyond FLOAT32_SAMPLES samples."""
    layers: NDArray[Any] | None = None
    """(replicates, height, width) of LAYERS, where layers are asked for."""

    def __post_init__(self) -> None:
        n = self.sample_count
        if n < 1 or n & (n - 1) or self.first_sample % n:
            raise ValueError(
                f"a node's range must be an aligned power of two, not [{self.first_sample}, +{n})"
            )

    @property
    def end(self) -> int:
        return self.first_sample + self.sample_count


def empty_node(tile: Tile, replicates: int, first: int, count: int, *, layers: bool = False) -> SumNode:
    """A range of which no pixel takes a sample."""
    shape = (replicates, tile.height, tile.width)
    sums = no_sums(shape, wide=count > FLOAT32_SAMPLES)
    return SumNode(tile, first, count, sums, np.zeros(shape, LAYERS) if layers else None)


def siblings(left: SumNode, right: SumNode) -> bool:
    """Whether the two are the children of one parent, in index order."""
    n = left.sample_count
    return (
        left.tile == right.tile
        and right.sample_count == n
        and right.first_sample == left.first_sample + n
        and left.first_sample % (2 * n) == 0
    )


def merge(left: SumNode, right: SumNode) -> SumNode:
    """The parent of two siblings."""
    if not siblings(left, right):
        raise ValueError(
            f"[{left.first_sample}, {left.end}) and [{right.first_sample}, {right.end}) are not siblings of one tile"
        )
    count = left.sample_count * 2
    sums = left.sums.plus(right.sums, wide=count > FLOAT32_SAMPLES)
    return SumNode(left.tile, left.first_sample, count, sums, _merge_layers(left.layers, right.layers))


def _merge_layers(left: NDArray[Any] | None, right: NDArray[Any] | None) -> NDArray[Any] | None:
    if left is None or right is None:
        return None
    merged = np.empty(left.shape, LAYERS)
    np.add(left["albedo_depth"], right["albedo_depth"], out=merged["albedo_depth"])
    np.add(left["normal"], right["normal"], out=merged["normal"])
    merged["object_id"] = left["object_id"]
    return merged


def joined(parts: Sequence[SumNode]) -> SumNode:
    """One node of the replicates of all, in this order; they are of one tile and range."""
    sums = of_replicates([part.sums for part in parts])
    layers = [part.layers for part in parts if part.layers is not None]
    first = parts[0]
    return SumNode(
        first.tile, first.first_sample, first.sample_count, sums, np.concatenate(layers) if layers else None
    )


def aligned_ranges(first: int, end: int) -> list[tuple[int, int]]:
    """The fewest aligned power-of-two ranges (first, count) that make up [first, end), in order."""
    ranges = []
    while first < end:
        count = (first & -first) or 1 << (end - first).bit_length()
        while count > end - first:
            count >>= 1
        ranges.append((first, count))
        first += count
    return ranges
