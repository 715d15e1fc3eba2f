"""Where a job's leases are handed out and come back: the one thing that the engine's thread and the run's
share."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Final

from penumbra_service.engine.protocol import DeviceDescription, Lease, RenderSpec
from penumbra_service.jobs.planning import LeasePlanner, WorkItem

MIN_DEADLINE: Final = 60.0
"""Seconds that every lease may take."""
UNKNOWN_DEADLINE: Final = 600.0
"""For a device's first lease on a job, of which only the samples are known."""
DEADLINE_FACTOR: Final = 20.0
"""Times the seconds that a lease should take."""


class LeaseDesk:
    """A planner behind a lock. All methods may be called from any thread and return at once."""

    def __init__(self, job: str, spec: RenderSpec, hungry: Callable[[], None]) -> None:
        """`hungry` is called (engine's thread) when a device asks in vain, once until work is added."""
        self._job = job
        self._spec = spec
        self._hungry = hungry
        self._lock = threading.Lock()
        self._planner = LeasePlanner(spec.replicates)
        self._numbers: dict[str, int] = {}
        self._excluded: set[str] = set()
        self._closed = False
        self._asked = False

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """Work for a device, or None."""
        with self._lock:
            if self._closed or device.id in self._excluded:
                return None
            planned = self._planner.take(device.id)
            if planned is not None:
                expected = self._planner.expected_seconds(device.id, planned)
                lease_id = f"{self._job}/{planned.number}"
                self._numbers[lease_id] = planned.number
                return Lease(lease_id, self._job, self._spec, planned.items, _deadline(expected))
            if self._asked:
                return None
            self._asked = True
        self._hungry()
        return None

    def add(self, items: Iterable[WorkItem]) -> None:
        """More work, after what waits already."""
        with self._lock:
            self._planner.add(items)
            self._asked = False

    def answered(self, lease: str, device: str, seconds: float) -> bool:
        """A lease is done, after `seconds` of tracing; False where nobody waits for it any more."""
        with self._lock:
            number = self._numbers.pop(lease, None)
            return number is not None and self._planner.done(number, device, seconds) is not None

    def give_back(self, lease: str) -> None:
        """A lease will not be answered: its work goes to the front."""
        with self._lock:
            number = self._numbers.pop(lease, None)
            if number is not None:
                self._planner.lost(number)
            self._asked = False

    def exclude(self, device: str) -> bool:
        """Give this device no more; False where it was excluded before."""
        with self._lock:
            first = device not in self._excluded
            self._excluded.add(device)
            return first

    def allowed(self, devices: Iterable[DeviceDescription]) -> list[DeviceDescription]:
        """Those that are not excluded; the planner shares the work among so many from now on."""
        with self._lock:
            allowed = [device for device in devices if device.id not in self._excluded]
            self._planner.devices = max(len(allowed), 1)
            return allowed

    def close(self) -> None:
        """Hand out nothing more, wait for nothing."""
        with self._lock:
            self._closed = True
            self._planner.drop()

    @property
    def idle(self) -> bool:
        """Whether nothing waits to be handed out."""
        with self._lock:
            return self._planner.idle

    @property
    def out_samples(self) -> int:
        """Samples in leases under way, all pixels and replicates together."""
        with self._lock:
            return self._planner.out_samples


def _deadline(expected: float | None) -> float:
    return UNKNOWN_DEADLINE if expected is None else max(MIN_DEADLINE, DEADLINE_FACTOR * expected)
