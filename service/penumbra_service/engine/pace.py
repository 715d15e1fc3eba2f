"""How fast a run really gets on: samples that have arrived over seconds of tracing by the clock. Pure.

Devices' own rates are no measure of that: tiles differ, so that a mean of rates is far above the rate of the
whole, and looking at batches, sending and waiting take their time as well.
"""

from __future__ import annotations

from collections import deque
from typing import Final

LEAST_WINDOW: Final = 30.0
"""Seconds of tracing that are averaged over at least: many tiles, cheap ones and dear ones."""
WINDOW_SHARE: Final = 0.5
"""And at least this share of the run: long batches go through the picture slowly."""
EARLIER_SECONDS: Final = 10.0
"""What the pace of earlier runs of a job counts at a restart, falling to nothing over LEAST_WINDOW."""


class Pace:
    """Deliveries of one run. Times are seconds of tracing as TraceClock counts them."""

    def __init__(self, seconds: float = 0.0, samples: float = 0.0) -> None:
        """`seconds` of earlier runs of the job, which brought so many `samples`."""
        self._start = seconds
        self._earlier = samples / seconds if seconds > 0 and samples > 0 else None
        self._marks: deque[tuple[float, float]] = deque([(seconds, 0.0)])

    def deliver(self, seconds: float, samples: float) -> None:
        """So many samples have arrived when the clock stood at `seconds`."""
        self._marks.append((seconds, self._marks[-1][1] + samples))
        window = max(LEAST_WINDOW, WINDOW_SHARE * (seconds - self._start))
        while len(self._marks) > 2 and self._marks[1][0] <= seconds - window:
            self._marks.popleft()

    @property
    def rate(self) -> float | None:
        """Samples a second; None before anything has arrived."""
        (since, before), (until, now) = self._marks[0], self._marks[-1]
        elapsed, arrived = until - since, now - before
        if self._earlier is None:
            return arrived / elapsed if elapsed > 0 and arrived > 0 else None
        weight = EARLIER_SECONDS * max(1.0 - (until - self._start) / LEAST_WINDOW, 0.0)
        total = weight + elapsed
        return (self._earlier * weight + arrived) / total if total > 0 else self._earlier
