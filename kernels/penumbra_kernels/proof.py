"""Proof, on the device itself and on the very scene, that two of its programs give the same bits; and how fast each is.

The suite proves it for every effect and every pair of them, on the devices that it ran on. A driver that nobody has tested
may still round one program otherwise; so before one takes over a picture from another, both render the same samples.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from penumbra_kernels.blocks import blocks_of
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.tracer import Tracer

BLOCKS: Final = 16
ROUNDS: Final = 2
"""The least time of several counts: whatever else the machine does only adds."""


def compare(own: Tracer, other: Tracer, window: Tile) -> float | None:
    """How much faster `own` is, on one sample of each replicate in blocks spread over the window; None where any bit
    differs. Raises DeviceError."""
    blocks = blocks_of(window, BLOCKS)
    seconds = {own: float("inf"), other: float("inf")}
    for _ in range(ROUNDS):
        sums = []
        for tracer in (own, other):
            started = time.perf_counter()
            sums.append([tracer.trace(block, 0, 1) for block in blocks])
            seconds[tracer] = min(seconds[tracer], time.perf_counter() - started)
        if not _equal(*sums):
            return None
    return seconds[other] / seconds[own]


def _equal(ours: Sequence[SumNode], theirs: Sequence[SumNode]) -> bool:
    return all(_bits(a) == _bits(b) for a, b in zip(ours, theirs, strict=True))


def _bits(node: SumNode) -> bytes:
    return node.sums.tobytes() + (b"" if node.layers is None else node.layers.tobytes())
