"""A device's shown rate: samples over seconds of tracing, the last leases above all. Pure."""

from __future__ import annotations

import math
from typing import Final

from penumbra_service.engine.protocol import LeaseResult

RATE_SECONDS: Final = 10.0
"""Of tracing, after which a lease counts 1/e of its samples and seconds in the rate."""


class RunningRate:
    """Leases count by what they took: the mean of the rates of cheap and dear tiles would be far too high."""

    def __init__(self) -> None:
        self.samples_per_second: float | None = None
        self._samples = self._seconds = 0.0

    def measure(self, result: LeaseResult) -> None:
        """Take a lease's answer into account."""
        if result.seconds <= 0:
            return
        samples = sum(node.sums.size * node.sample_count for node in result.nodes)
        kept = math.exp(-result.seconds / RATE_SECONDS)
        self._samples = kept * self._samples + samples
        self._seconds = kept * self._seconds + result.seconds
        self.samples_per_second = self._samples / self._seconds
