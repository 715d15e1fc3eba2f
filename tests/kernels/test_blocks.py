"""Blocks spread over a window: inside it, nowhere twice, in every part of it."""

from __future__ import annotations

import pytest
from penumbra_kernels.blocks import BLOCK, blocks_of
from penumbra_kernels.nodes import Tile


@pytest.mark.parametrize("size", [(64, 64), (640, 8), (9, 200), (5, 3), (1920, 1080)])
@pytest.mark.parametrize("count", [1, 16, 200])
def test_blocks_lie_in_the_window_and_nowhere_twice(size: tuple[int, int], count: int) -> None:
    window = Tile(3, 7, *size)
    blocks = blocks_of(window, count)
    assert 1 <= len(blocks) <= count
    assert len({(b.x, b.y) for b in blocks}) == len(blocks)
    for b in blocks:
        assert (b.width, b.height) == (min(BLOCK, size[0]), min(BLOCK, size[1]))
        assert window.x <= b.x
        assert b.x + b.width <= window.x + window.width
        assert window.y <= b.y
        assert b.y + b.height <= window.y + window.height


def test_blocks_spread_over_a_large_window() -> None:
    blocks = blocks_of(Tile(0, 0, 640, 640), 64)
    assert {(b.x // 80, b.y // 80) for b in blocks} == {(i, j) for i in range(8) for j in range(8)}
