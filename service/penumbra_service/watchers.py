"""Who watches jobs: threads ring, coroutines wake. What changed is read from the ledger, so nothing is
lost here."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Watch:
    """One watcher's bell, in its event loop."""

    def __init__(self, job_id: str | None) -> None:
        self.job_id = job_id
        self._loop = asyncio.get_running_loop()
        self._bell = asyncio.Event()
        self._changed: set[str] = set()

    def ring(self, job_id: str) -> None:
        """From any thread. A loop that has ended needs no bell."""
        try:
            self._loop.call_soon_threadsafe(self._note, job_id)
        except RuntimeError:
            return

    def _note(self, job_id: str) -> None:
        self._changed.add(job_id)
        self._bell.set()

    async def changed(self, timeout: float) -> set[str]:
        """Jobs that changed since the last call; empty after `timeout` seconds without any."""
        try:
            await asyncio.wait_for(self._bell.wait(), timeout)
        except TimeoutError:
            return set()
        self._bell.clear()
        changed, self._changed = self._changed, set()
        return changed


class Watchers:
    """All of them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watches: set[Watch] = set()

    @contextmanager
    def watch(self, job_id: str | None = None) -> Iterator[Watch]:
        """A bell for one job, or for all. To be used in a coroutine."""
        watch = Watch(job_id)
        with self._lock:
            self._watches.add(watch)
        try:
            yield watch
        finally:
            with self._lock:
                self._watches.discard(watch)

    def ring(self, job_id: str) -> None:
        """Tells whoever watches this job that it has changed."""
        with self._lock:
            watches = [watch for watch in self._watches if watch.job_id in (None, job_id)]
        for watch in watches:
            watch.ring(job_id)
