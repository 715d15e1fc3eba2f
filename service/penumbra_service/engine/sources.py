"""Who wants leases of an engine: whose turn it is, what devices hold, and how news reaches the jobs. The same for the local
engine and a farm.

Thread-safe; jobs (LeaseSource) are never called while the lock is held. What is logged here names job, lease and device.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from penumbra_service.engine.protocol import (
    NOBODY,
    DeviceDescription,
    Lease,
    LeaseFailure,
    LeaseLost,
    LeaseResult,
    LeaseSource,
    NoDevice,
    ToJob,
)
from penumbra_service.jobs.dispatch import Dispatcher

log = logging.getLogger(__name__)


@dataclass
class Held:
    """A lease that a device has."""

    lease: Lease
    source: LeaseSource


class LeaseSources:
    """Of one engine."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._dispatcher: Dispatcher[LeaseSource] = Dispatcher()

    def __len__(self) -> int:
        with self._lock:
            return len(self._dispatcher)

    def attach(self, source: LeaseSource) -> None:
        """It wants leases from now on."""
        with self._lock:
            self._dispatcher.attach(source)

    def detach(self, source: LeaseSource) -> None:
        """It wants none any more; answers to its leases are thrown away."""
        with self._lock:
            self._dispatcher.detach(source)

    def take(
        self, device: DeviceDescription, awaits: Callable[[str], bool] = lambda scene: False
    ) -> Held | None:
        """The next lease for a device. `awaits`: whether more leases of a scene would only wait."""
        with self._lock:
            sources = self._dispatcher.order(device.id)
        for source in sources:
            lease = None if awaits(source.scene) else source.next_lease(device)
            if lease is not None:
                with self._lock:
                    self._dispatcher.gave(device.id, source)
                log.debug("a lease goes to %s", device.id, extra=_fields(lease, device))
                return Held(lease, source)
        return None

    def deliver(self, source: LeaseSource, device: DeviceDescription, event: ToJob) -> None:
        """News for a job, if it still wants any."""
        with self._lock:
            wanted = source in self._dispatcher
        if wanted:
            source.deliver(device, event)

    def answer(self, held: Held, device: DeviceDescription, event: LeaseResult | LeaseFailure) -> None:
        """A device is through with a lease."""
        if isinstance(event, LeaseFailure):
            log.warning(
                "device %s cannot do a lease (%s): %s",
                device.id,
                event.kind,
                event.message,
                extra=_fields(held.lease, device),
            )
        else:
            log.debug("a lease took %.3f s", event.seconds, extra=_fields(held.lease, device))
        self.deliver(held.source, device, event)

    def lose(
        self, held: Iterable[Held], device: DeviceDescription, reason: str, blamed: str | None = None
    ) -> None:
        """A device is gone, and with it whatever it had loaded: its leases go back to their jobs. `blamed`: the lease that
        its process worked on when it ended."""
        with self._lock:
            self._dispatcher.forget(device.id)
        for one in held:
            log.warning("a lease is lost: %s", reason, extra=_fields(one.lease, device))
            lost = LeaseLost(one.lease.id, device.id, one.lease.id == blamed, reason)
            self.deliver(one.source, device, lost)

    def give_up(self, reason: str) -> None:
        """Nothing is left that could render: every job hears it."""
        with self._lock:
            sources = self._dispatcher.order()
        for source in sources:
            self.detach(source)
            source.deliver(NOBODY, NoDevice(reason))


def _fields(lease: Lease, device: DeviceDescription) -> dict[str, str]:
    """For the log (logs.FIELDS)."""
    return {"job": lease.job, "lease": lease.id, "device": device.id}
