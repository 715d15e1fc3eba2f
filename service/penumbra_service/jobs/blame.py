"""Whose fault is it when a device's process dies, hangs or refuses under a job: the device's, or the job's? Pure.

A device that fails a job three times is blocked for it and the others go on. A job fails under whatever renders it
where three devices in a row fail without anybody finishing a lease, or the same work fails on three devices, or no
device is left.
"""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum, auto
from typing import Final

MAX_FAILURES: Final = 3
"""Of one device under one job, until it is blocked; of devices, until the job is blamed."""


class Verdict(Enum):
    """What follows from a failure."""

    GO_ON = auto()
    """Issue the lease again, to whoever is there."""
    BLOCK = auto()
    """Give this device no more of this job."""
    FAIL = auto()
    """The job is to blame."""


class Blame:
    """Failures of one run; those of each device are counted by the caller, over restarts too."""

    def __init__(self) -> None:
        self._since: set[str] = set()

    def delivered(self) -> None:
        """A device has finished a lease: the job can be rendered."""
        self._since.clear()

    def failed(self, device: str, failures: int, tried: Collection[str]) -> Verdict:
        """`device` has failed for the `failures`-th time; its lease's work has failed on all of `tried`."""
        self._since.add(device)
        if max(len(self._since), len(tried)) >= MAX_FAILURES:
            return Verdict.FAIL
        return Verdict.BLOCK if failures >= MAX_FAILURES else Verdict.GO_ON
