"""Sum nodes of known samples, for the film's tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.nodes import SumNode, Tile, merge
from penumbra_kernels.sums import no_sums

Draw = Callable[[Tile, int, int], NDArray[Any]]
"""(tile, replicates, sample index) -> (replicates, height, width, 4): one sample of every pixel and
replicate."""


def _leaf(tile: Tile, replicates: int, index: int, draw: Draw) -> SumNode:
    sums = no_sums((replicates, tile.height, tile.width))
    values = draw(tile, replicates, index).astype(np.float32)
    sums["rgba"] = values
    sums["taken"] = 1
    sums["lit"] = (values[..., :3] > 0).any(axis=-1)
    return SumNode(tile, index, 1, sums)


class Samples:
    """Makes nodes of any range out of one-sample leaves, by the rule of penumbra_kernels.nodes."""

    def __init__(self, draw: Draw, replicates: int = 8) -> None:
        self.draw = draw
        self.replicates = replicates

    def node(self, tile: Tile, first: int, count: int) -> SumNode:
        if count == 1:
            return _leaf(tile, self.replicates, first, self.draw)
        half = count // 2
        return merge(self.node(tile, first, half), self.node(tile, first + half, half))


def noise(tile: Tile, replicates: int, index: int) -> NDArray[Any]:
    """Numbers in [0, 1) that depend on pixel, replicate and index alone, not on the tile."""
    y, x = np.mgrid[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width].astype(np.uint64)
    r = np.arange(replicates, dtype=np.uint64)[:, None, None, None]
    c = np.arange(4, dtype=np.uint64)
    key = (((x << np.uint64(20)) + y)[..., None] * np.uint64(8) + c)[None]
    key = (key * np.uint64(1 << 8) + r) * np.uint64(1 << 16) + np.uint64(index)
    for _ in range(2):
        key = (key ^ (key >> np.uint64(31))) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    result: NDArray[Any] = (key >> np.uint64(40)).astype(np.float64) * 2.0**-24
    return result


@pytest.fixture
def samples() -> Callable[..., Samples]:
    """Samples(draw=noise, replicates=8)."""
    return lambda draw=noise, replicates=8: Samples(draw, replicates)
