"""How devices stand with one job: what they have failed at over all of its frames, and which get no more of it."""

from __future__ import annotations

import threading


class Standing:
    """Shared by the runs of a job's frames. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._failures: dict[tuple[str, str], int] = {}
        """By run and device."""
        self._blocked: set[str] = set()
        self.over: str | None = None
        """Why no run can go on, if so: no device is left."""

    def failed(self, run: str, device: str, failures: int) -> int:
        """A run has seen so many failures of a device, those before a restart included; all runs together."""
        with self._lock:
            self._failures[run, device] = failures
            return sum(count for (_, name), count in self._failures.items() if name == device)

    def block(self, device: str) -> None:
        """No run gives it any more."""
        with self._lock:
            self._blocked.add(device)

    def blocked(self, device: str) -> bool:
        """Whether some run has blocked it."""
        with self._lock:
            return device in self._blocked
