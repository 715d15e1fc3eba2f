"""Seconds of tracing, over all runs of a job."""

from __future__ import annotations

import time


class TraceClock:
    """Runs from the first scene that a device has loaded until the run ends. `before`: seconds of earlier
    runs."""

    def __init__(self, before: float) -> None:
        self._before = before
        self._since: float | None = None

    def start(self) -> None:
        """Does nothing where it runs already."""
        if self._since is None:
            self._since = time.monotonic()

    def stop(self) -> None:
        """Hold the present value."""
        self._before, self._since = self.seconds, None

    @property
    def seconds(self) -> float:
        return self._before + (0.0 if self._since is None else time.monotonic() - self._since)
