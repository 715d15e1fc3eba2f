"""Which lease next: work items (tile, aligned power-of-two range of samples) grouped to one or two seconds of
a device.

Pure: knows neither devices nor clocks, only the rates that it is told. How work is cut changes no bits, so it
may follow the machines' speed freely.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from typing import Final

from penumbra_kernels.layout import LAYERS
from penumbra_kernels.nodes import FLOAT32_SAMPLES, Tile
from penumbra_kernels.sums import NARROW_BYTES, WIDE_BYTES

from penumbra_service.film.levels import LevelMap

LEASE_SECONDS: Final = 2.0
"""The most that a lease should take: work is cut in halves, so that most take one to two seconds. Long against the some
5 ms of its way there and back, short enough to be done again."""
FIRST_LEASE_SAMPLES: Final = 1 << 17
"""Samples of a device's first lease, before its rate is known: some 0.1 s of one core. More on a large farm, in proportion
to its leases."""
MAX_GROWTH: Final = 8
"""A lease holds at most so many times the samples of the device's largest before: first rates are poor
guesses."""
LEASES_PER_SECOND: Final = 50
"""That one service hands out and takes in: a farm of more devices gets longer leases."""
LEAST_SECONDS: Final = 0.1
"""Leases get no shorter as the work runs out: their way through a farm takes some 10 ms of processor time, and nobody waits
longer for the last one."""
LEAST_SHARE: Final = 1 / 8
"""Of the longer leases of a large farm: however many devices share the last work, none gets less. Each halving of the
shortest lease is two more for every device at the end of every job."""
BATCH_SHARE: Final = 1 / 8
"""Of the seconds that a batch takes: leases get no shorter where another batch follows, since devices then need not end
together, and the batch is looked at that much later at most."""
MAX_LEASE_BYTES: Final = 32 * 1024 * 1024
"""Of sum nodes in an answer."""
MAX_LEASE_ITEMS: Final = 256
RATE_WEIGHT: Final = 0.5
"""Of the newest measurement in a device's running rate."""


def lease_seconds(devices: int) -> float:
    """What a lease should take where so many devices work."""
    return max(LEASE_SECONDS, devices / LEASES_PER_SECOND)


@dataclass(frozen=True, slots=True)
class WorkItem:
    """One sum node to be made."""

    tile: Tile
    first: int
    count: int

    @property
    def end(self) -> int:
        return self.first + self.count

    def halves(self) -> tuple[WorkItem, WorkItem]:
        """The two children, in index order."""
        half = self.count // 2
        return WorkItem(self.tile, self.first, half), WorkItem(self.tile, self.first + half, half)


@dataclass(frozen=True, slots=True)
class PlannedLease:
    """Work for one device."""

    number: int
    items: tuple[WorkItem, ...]
    samples: int
    """All pixels and replicates together."""
    attempt: int = 1


@dataclass
class _Rate:
    samples_per_second: float | None = None
    largest: int = FIRST_LEASE_SAMPLES // MAX_GROWTH


class LeasePlanner:
    """The ready work of one job, and the leases that are out. Not thread-safe: its owner holds a lock."""

    def __init__(self, replicates: int, devices: int = 1) -> None:
        self.replicates = replicates
        self.levels: LevelMap | None = None
        """How pixels share in the axis of samples; None: each takes all. To be set while no work is ready or out."""
        self.devices = devices
        """How many share the work: the last leases shrink so that all end together."""
        self.redone = 0
        """Leases that had to be issued again."""
        self._ready: deque[WorkItem] = deque()
        self._ready_samples = 0
        self._shortest = 0.0
        """Seconds of the shortest lease, where a batch follows that which is handed out."""
        self._attempts: dict[WorkItem, int] = {}
        self._failed_on: dict[WorkItem, frozenset[str]] = {}
        self._out: dict[int, PlannedLease] = {}
        self._rates: dict[str, _Rate] = {}
        self._next = 1

    @property
    def idle(self) -> bool:
        """Whether nothing is left to be handed out."""
        return not self._ready

    @property
    def ready_samples(self) -> int:
        """Samples that wait to be handed out, all pixels and replicates together."""
        return self._ready_samples

    @property
    def out_samples(self) -> int:
        """Samples in leases under way."""
        return sum(lease.samples for lease in self._out.values())

    @property
    def rate(self) -> float | None:
        """Samples a second of all devices that have answered together."""
        known = [r.samples_per_second for r in self._rates.values() if r.samples_per_second]
        return sum(known) if known else None

    def rate_of(self, device: str) -> float | None:
        """Samples a second of one device."""
        rate = self._rates.get(device)
        return rate.samples_per_second if rate else None

    def samples_of(self, item: WorkItem) -> int:
        """All pixels and replicates of an item together."""
        if self.levels is not None:
            return self.replicates * self.levels.samples(item.tile, item.first, item.count)
        return self.replicates * item.tile.width * item.tile.height * item.count

    def add(self, items: Iterable[WorkItem], *, more_follows: bool = False) -> None:
        """Put work at the end of the queue. `more_follows`: it is a batch, and as much or more comes after it."""
        before = self._ready_samples
        for item in items:
            self._ready.append(item)
            self._ready_samples += self.samples_of(item)
        rate = self.rate if more_follows else None
        self._shortest = BATCH_SHARE * (self._ready_samples - before) / rate if rate else 0.0

    def not_under_way(self, items: Iterable[WorkItem]) -> list[WorkItem]:
        """What of these items neither waits nor is out, in their order: of a tile that starts again, what there is to
        add."""
        asked = list(items)
        tiles = {item.tile for item in asked}
        known: dict[Tile, list[WorkItem]] = {}
        for item in chain(self._ready, *(lease.items for lease in self._out.values())):
            if item.tile in tiles:
                known.setdefault(item.tile, []).append(item)
        left = []
        asked.reverse()
        while asked:
            item = asked.pop()
            others = [o for o in known.get(item.tile, ()) if o.first < item.end and item.first < o.end]
            if not others:
                left.append(item)
            elif all(
                o.count < item.count for o in others
            ):  # aligned ranges are apart, or one lies within the other
                asked.extend(reversed(item.halves()))
        return left

    def take(self, device: str) -> PlannedLease | None:
        """The next lease for a device, or None where nothing is ready."""
        budget = self._budget(device)
        items: list[WorkItem] = []
        samples = size = 0
        while self._ready and len(items) < MAX_LEASE_ITEMS:
            more = self.samples_of(self._ready[0]) if items else self._split_first(budget)
            item = self._ready[0]
            room = self._bytes(item)
            if items and (samples + more > budget or size + room > MAX_LEASE_BYTES):
                break
            self._ready.popleft()
            items.append(item)
            samples += more
            size += room
        if not items:
            return None
        self._ready_samples -= samples
        attempt = 1 + max(self._attempts.get(item, 0) for item in items) if self._attempts else 1
        lease = PlannedLease(self._next, tuple(items), samples, attempt)
        self._next += 1
        self._out[lease.number] = lease
        rate = self._rate_on(device)
        rate.largest = max(rate.largest, samples)
        return lease

    def done(self, number: int, device: str, seconds: float) -> PlannedLease | None:
        """A lease has been answered after `seconds` of tracing; None where it was given up before."""
        lease = self._out.pop(number, None)
        if lease is not None and seconds > 0 and lease.samples > 0:
            self._measure(device, lease.samples / seconds)
        if lease is not None and lease.attempt > 1:
            for item in lease.items:
                self._attempts.pop(item, None)
        return lease

    def lost(self, number: int, failed_on: str | None = None) -> PlannedLease | None:
        """A lease will not be answered: its work goes to the front of the queue. `failed_on`: the device that it
        failed on, if it did."""
        lease = self._out.pop(number, None)
        if lease is None:
            return None
        for item in lease.items:
            self._attempts[item] = lease.attempt
            if failed_on is not None:
                self._failed_on[item] = self.failed_on(item) | {failed_on}
        for item in reversed(lease.items):
            self._push_front(item)
        self.redone += 1
        return lease

    def failed_on(self, item: WorkItem) -> frozenset[str]:
        """Devices that this work has failed on."""
        return self._failed_on.get(item, frozenset())

    def drop(self) -> None:
        """Forget all work; answers to leases under way are not waited for."""
        self._ready.clear()
        self._ready_samples = 0
        self._out.clear()

    def expected_seconds(self, device: str, lease: PlannedLease) -> float | None:
        """What a lease should take, None where the device's rate is not known."""
        rate = self.rate_of(device)
        return lease.samples / rate if rate else None

    def _budget(self, device: str) -> int:
        rate, seconds = self._rates.get(device), lease_seconds(self.devices)
        first = int(FIRST_LEASE_SAMPLES * seconds / LEASE_SECONDS)
        most = rate.largest * MAX_GROWTH if rate else first
        least = FIRST_LEASE_SAMPLES // MAX_GROWTH
        if rate is not None and rate.samples_per_second is not None:
            most = min(most, int(rate.samples_per_second * seconds))
            shortest = max((seconds - LEASE_SECONDS) * LEAST_SHARE, LEAST_SECONDS, self._shortest)
            least = max(least, min(most, int(rate.samples_per_second * shortest)))
        share = self.ready_samples // (2 * max(self.devices, 1))
        return max(min(most, share), least)

    def _push_front(self, item: WorkItem) -> None:
        self._ready.appendleft(item)
        self._ready_samples += self.samples_of(item)

    def _split_first(self, budget: int) -> int:
        """Halve the first item that waits until it fits, or cannot be halved; its samples."""
        while True:
            samples = self.samples_of(self._ready[0])
            if samples <= budget or self._ready[0].count == 1:
                return samples
            item = self._ready.popleft()
            first, second = item.halves()
            self._ready.extendleft((second, first))
            if self._attempts and item in self._attempts:
                self._attempts[first] = self._attempts[second] = self._attempts.pop(item)
            if self._failed_on and item in self._failed_on:
                self._failed_on[first] = self._failed_on[second] = self._failed_on.pop(item)

    def _bytes(self, item: WorkItem) -> int:
        # Nodes of up to FLOAT32_SAMPLES are smaller; layers may be absent: this is the bound.
        entry = (WIDE_BYTES if item.count > FLOAT32_SAMPLES else NARROW_BYTES) + LAYERS.itemsize
        return entry * self.replicates * item.tile.width * item.tile.height

    def _rate_on(self, device: str) -> _Rate:
        rate = self._rates.get(device)
        if rate is None:
            rate = self._rates[device] = _Rate()
        return rate

    def _measure(self, device: str, samples_per_second: float) -> None:
        rate = self._rate_on(device)
        before = rate.samples_per_second
        if before is None:
            rate.samples_per_second = samples_per_second
        else:
            rate.samples_per_second = RATE_WEIGHT * samples_per_second + (1 - RATE_WEIGHT) * before
