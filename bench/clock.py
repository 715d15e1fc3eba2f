"""The clock of all measurements here."""

from __future__ import annotations

import os
import time


def cores() -> int:
    """On how many cores this process may run."""
    return len(os.sched_getaffinity(0))


def clock() -> float:
    """On one core seconds of CPU, which other programs' work hardly lengthens; on several, seconds."""
    return time.process_time() if cores() == 1 else time.perf_counter()
