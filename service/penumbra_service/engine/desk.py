"""Where a job's leases are handed out and come back: the one thing that the engine's thread and the run's
share."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Final

from penumbra_kernels.allotment import Allotment
from penumbra_kernels.nodes import Tile

from penumbra_service.engine.protocol import DeviceDescription, Lease, LeaseResult, RenderSpec
from penumbra_service.film.levels import LevelMap
from penumbra_service.jobs.doublecheck import DoubleChecks, digest_of
from penumbra_service.jobs.planning import LeasePlanner, WorkItem

MIN_DEADLINE: Final = 60.0
"""Seconds that every lease may take."""
UNKNOWN_DEADLINE: Final = 600.0
"""For a device's first lease on a job, of which only the samples are known."""
DEADLINE_FACTOR: Final = 20.0
"""Times the seconds that a lease should take."""


class LeaseDesk:
    """A planner behind a lock. All methods may be called from any thread and return at once."""

    def __init__(
        self,
        job: str,
        spec: RenderSpec,
        hungry: Callable[[], None],
        busy: Callable[[bool], None] = lambda busy: None,
        barred: Callable[[str], bool] = lambda device: False,
        name: str | None = None,
        *,
        strict: bool = False,
        verify: float = 0.0,
    ) -> None:
        """`hungry` is called (engine's thread) when a device asks in vain, once until work is added; `busy` with
        whether a lease is under way, whenever that may have changed. `barred`: whether a device, by its id, gets nothing
        of the whole job. `name` begins the names of leases: the job's,
        unless it has several frames. `strict`: all devices must be of the bit class of the first. `verify`: share of
        leases that two devices do."""
        self._job = job
        self._name = name or job
        self._spec = spec
        self._hungry = hungry
        self._busy = busy
        self._barred = barred
        self._lock = threading.Lock()
        self._planner = LeasePlanner(spec.replicates)
        self._numbers: dict[str, int] = {}
        self._allot: Callable[[Tile], Allotment] | None = None
        self._excluded: set[str] = set()
        self._strict = strict
        self._bit_class: str | None = None
        self._checks = DoubleChecks(job, verify)
        self._checking: dict[str, int] = {}
        self._closed = False
        self._asked = False

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """Work for a device, or None."""
        with self._lock:
            if self._closed or not self._suits(device):
                return None
            check = self._checks.take((device.id, device.bit_class))
            if check is not None:
                lease_id = f"{self._name}/check-{check.number}-{device.id}"
                self._checking[lease_id] = check.number
                return self._lease(lease_id, check.items, UNKNOWN_DEADLINE)
            planned = self._planner.take(device.id)
            if planned is not None:
                expected = self._planner.expected_seconds(device.id, planned)
                lease_id = f"{self._name}/{planned.number}"
                self._numbers[lease_id] = planned.number
                self._bit_class = self._bit_class or device.bit_class
                self._busy(True)
                return self._lease(lease_id, planned.items, _deadline(expected))
            if self._asked:
                return None
            self._asked = True
        self._hungry()
        return None

    def share(self, levels: LevelMap, allot: Callable[[Tile], Allotment], *, anew: bool) -> None:
        """Adaptive: from now on, with nothing ready or out, pixels take so much of the axis of samples. `anew`: the axis
        holds other samples than before, so that checks of those can be decided no more."""
        with self._lock:
            self._planner.drop()
            self._planner.levels = levels
            self._allot = allot
            if anew:
                self._checks.drop()

    def _lease(self, lease_id: str, items: tuple[WorkItem, ...], deadline: float) -> Lease:
        allot = self._allot
        tiles = {item.tile: allot(item.tile) for item in items} if allot else {}
        return Lease(lease_id, self._job, self._spec, items, deadline, tiles)

    def add(self, items: Iterable[WorkItem], *, again: bool = False, more_follows: bool = False) -> None:
        """More work, after what waits already. `again`: some of it may wait or be out; `more_follows`: it is a batch, and
        another is sure to come."""
        with self._lock:
            self._planner.add(
                self._planner.not_under_way(items) if again else items, more_follows=more_follows
            )
            self._asked = False

    def answered(self, result: LeaseResult, device: DeviceDescription) -> bool:
        """A lease is done; False where nobody waits for it any more, or it was a check."""
        with self._lock:
            number = self._pop(result.lease)
            lease = None if number is None else self._planner.done(number, device.id, result.seconds)
            if lease is None:
                return False
            if self._checks.wants(device.id, lease.number):
                self._checks.open((device.id, device.bit_class), lease.items, digest_of(result.nodes))
                self._asked = False
            return True

    def checked(self, result: LeaseResult, device: DeviceDescription) -> list[str] | None:
        """Where this is the answer to a check: the devices that it proves wrong, mostly none. None otherwise."""
        with self._lock:
            number = self._checking.pop(result.lease, None)
            return (
                None if number is None else self._checks.answered(number, device.id, digest_of(result.nodes))
            )

    def give_back(self, lease: str, failed_on: str | None = None) -> frozenset[str]:
        """A lease will not be answered: its work goes to the front. `failed_on`: the device that it failed on, if it
        did. All devices that some of its work has failed on."""
        with self._lock:
            self._asked = False
            if lease in self._checking:
                self._checks.lost(self._checking.pop(lease))
            number = self._pop(lease)
            lost = None if number is None else self._planner.lost(number, failed_on)
            return (
                max((self._planner.failed_on(item) for item in lost.items), key=len) if lost else frozenset()
            )

    def disbelieve(self, device: str) -> None:
        """It has given wrong sums: no more for it, and its answers to checks are void."""
        with self._lock:
            self._excluded.add(device)
            self._checks.forget(device)

    def wind_up(self) -> None:
        """The picture is there: hand out nothing but checks, until work is added."""
        with self._lock:
            self._planner.drop()
            self._numbers.clear()
            self._busy(False)
            self._asked = True

    def suspend(self) -> None:
        """No answer will come any more: not to what is out, nor to checks that are, which others get."""
        self.wind_up()
        with self._lock:
            for number in self._checking.values():
                self._checks.lost(number)
            self._checking.clear()

    def keep_to(self, bit_class: str) -> None:
        """An earlier run of a strict job was of this class."""
        with self._lock:
            self._bit_class = bit_class

    def doubts(self, devices: Iterable[DeviceDescription]) -> bool:
        """Whether a check is open that one of these devices could decide."""
        with self._lock:
            return self._checks.pending((d.id, d.bit_class) for d in devices if self._suits(d))

    @property
    def disputes(self) -> list[tuple[str, ...]]:
        """Devices that contradict each other, and nobody has decided which is right."""
        with self._lock:
            return self._checks.disputes

    @property
    def checks(self) -> int:
        """Leases that two devices have done, and which is right."""
        with self._lock:
            return self._checks.done

    def exclude(self, device: str) -> bool:
        """Give this device no more; False where it was excluded before."""
        with self._lock:
            first = device not in self._excluded
            self._excluded.add(device)
            return first

    def allowed(self, devices: Iterable[DeviceDescription]) -> list[DeviceDescription]:
        """Those that are not excluded; the planner shares the work among so many from now on."""
        with self._lock:
            allowed = [device for device in devices if self._suits(device)]
            self._planner.devices = max(len(allowed), 1)
            return allowed

    def close(self) -> None:
        """Hand out nothing more, wait for nothing."""
        with self._lock:
            self._closed = True
            self._planner.drop()

    def _pop(self, lease: str) -> int | None:
        number = self._numbers.pop(lease, None)
        self._busy(bool(self._numbers))
        return number

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

    def _suits(self, device: DeviceDescription) -> bool:
        if device.id in self._excluded or self._barred(device.id):
            return False
        return not self._strict or self._bit_class in (None, device.bit_class)


def _deadline(expected: float | None) -> float:
    return UNKNOWN_DEADLINE if expected is None else max(MIN_DEADLINE, DEADLINE_FACTOR * expected)
