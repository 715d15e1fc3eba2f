"""What Dask is told where its defaults cost a farm processor time for nothing: it runs no tasks here."""

from __future__ import annotations

import contextlib
import logging
import resource
from typing import Any, Final

import dask

QUIET: Final[dict[str, Any]] = {
    "distributed.admin.tick.interval": "1 s",  # by default every process wakes up 50 times a second to see whether it hangs
    "distributed.admin.tick.limit": "10 s",
    "distributed.admin.system-monitor.interval": "5 s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.admin.low-level-log-length": 1000,
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "5 s",
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.client.scheduler-info-interval": "60 s",
}

MOST_FILES: Final = 1 << 16
"""Open at once. No more, since programs that close all that they might have inherited take their time over millions."""


def settle(**more: Any) -> None:
    """Configure Dask in this process, before anything of it starts."""
    dask.config.set({**QUIET, **more})
    logging.getLogger("distributed").setLevel("WARNING")
    # Where the scheduler cannot be reached the engine says so itself; Dask's client adds pages of tracebacks.
    logging.getLogger("distributed.client").setLevel("CRITICAL")
    _allow_sockets()


def environment() -> dict[str, str]:
    """The same for processes that Dask's own commands start: variables that Dask reads."""
    return {
        f"DASK_{name.upper().replace('.', '__').replace('-', '_')}": str(value)
        for name, value in QUIET.items()
    }


def _allow_sockets() -> None:
    """Scheduler and service hold one for each worker: up to MOST_FILES, if this process may have them without asking."""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_FILES if most == resource.RLIM_INFINITY else min(most, MOST_FILES)
    if now != resource.RLIM_INFINITY and now < wanted:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
