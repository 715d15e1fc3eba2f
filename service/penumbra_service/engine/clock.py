"""Seconds of tracing, over all runs of a job."""

from __future__ import annotations

import threading
import time


class TraceClock:
    """Runs while a lease is under way, from the first scene that a device has loaded until the run ends: what other
    jobs and frames have of the devices is no time of this one. `before`: seconds of earlier runs. Any thread."""

    def __init__(self, before: float) -> None:
        self._lock = threading.Lock()
        self._begin(before)

    def restart(self, before: float) -> None:
        """As if it were new."""
        with self._lock:
            self._begin(before)

    def start(self) -> None:
        """A device has loaded the scene. Does nothing where one had before."""
        with self._lock:
            self._started = True
            self._update()

    def busy(self, busy: bool) -> None:
        """Whether a lease is under way."""
        with self._lock:
            self._busy = busy
            self._update()

    def stop(self) -> None:
        """Hold the present value."""
        with self._lock:
            self._started = False
            self._update()

    @property
    def seconds(self) -> float:
        with self._lock:
            return self._before + self._running()

    def _begin(self, before: float) -> None:
        self._before = before
        self._since: float | None = None
        self._started = False
        self._busy = True

    def _running(self) -> float:
        return 0.0 if self._since is None else time.monotonic() - self._since

    def _update(self) -> None:
        runs = self._started and self._busy
        if runs and self._since is None:
            self._since = time.monotonic()
        elif not runs and self._since is not None:
            self._before, self._since = self._before + self._running(), None
