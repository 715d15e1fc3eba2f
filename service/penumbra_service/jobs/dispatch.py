"""Whose lease next: of several jobs, and several frames of one, which gets a device that asks for work.

Pure: knows neither processes nor clocks. The local engine, the Dask engine and bench/farm_simulation.py drive the
same Dispatcher; how a job's own work is cut into leases is planning.py's.

Higher priority goes first. Among equals the job whose error falls most for a second of a device does, so that every
job has a picture soon and none gets the whole farm for its last tenth of a percent; a job whose scene the device has
loaded is preferred, since to load another costs time. Frames of one job go in the order in which they came, except
that a device stays with a frame that it has loaded.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

IN_FLIGHT: Final = 2
"""Leases that a device holds: with one it idles while the answer travels."""
SCENES_KEPT: Final = 4
"""Loaded scenes that a device process keeps; the least recently used one goes first."""
AFFINITY: Final = 4.0
"""A job whose scene is loaded counts as if its error fell so many times as fast."""
LEAST_SECONDS: Final = 0.1
"""Device-seconds that every job counts as having had: what it gains at its start stays finite."""
UNKNOWN_RELMSE: Final = 1.0
"""Of a picture whose error nobody knows yet: all of it may be wrong."""


class Bidder(Protocol):
    """What the order looks at: a job, or one frame of a job."""

    @property
    def job(self) -> str:
        """Frames of one job name the same."""

    @property
    def priority(self) -> int: ...

    @property
    def scene(self) -> str:
        """Names what a device has to load; equal for equal scenes."""

    @property
    def gain(self) -> float:
        """Error that a second of a device takes away, see `gain_of`."""


S = TypeVar("S", bound=Bidder)


def gain_of(relmse: float, theta: float, device_seconds: float) -> float:
    """-d relMSE / dt after `device_seconds` t: theta relMSE / t, since relMSE falls as t^-theta.

    `relmse`: NaN where it is unknown.
    """
    known = relmse if math.isfinite(relmse) else UNKNOWN_RELMSE
    return max(theta, 0.0) * known / max(device_seconds, LEAST_SECONDS)


@dataclass(slots=True)
class _Queue(Generic[S]):
    """A job's sources, in the order in which they came."""

    arrived: int
    """When its oldest one came: no two jobs have the same."""
    head: S
    """Its oldest one: what the job gains is what that does."""
    sources: dict[S, int]
    """And when each came."""


class Dispatcher(Generic[S]):
    """Who wants leases, and what devices have loaded. Not thread-safe: its owner holds a lock."""

    def __init__(self) -> None:
        self._queues: dict[str, _Queue[S]] = {}
        """By job."""
        self._sources: set[S] = set()
        self._arrived = 0
        self._loaded: dict[str, OrderedDict[str, None]] = {}

    def attach(self, source: S) -> None:
        """It wants leases from now on, after all that came before."""
        self._sources.add(source)
        queue = self._queues.setdefault(source.job, _Queue(self._arrived, source, {}))
        queue.sources.setdefault(source, self._arrived)
        self._arrived += 1

    def detach(self, source: S) -> None:
        """It wants none any more."""
        if source in self._sources:
            self._sources.remove(source)
            queue = self._queues[source.job]
            del queue.sources[source]
            if not queue.sources:
                del self._queues[source.job]
            elif queue.head is source:
                queue.head, queue.arrived = next(iter(queue.sources.items()))

    def __contains__(self, source: S) -> bool:
        return source in self._sources

    def __len__(self) -> int:
        return len(self._sources)

    def order(self, device: str = "") -> list[S]:
        """All sources, in the order in which `device` should ask them."""
        if len(self._sources) < 2:
            return list(self._sources)
        loaded: Collection[str] = self._loaded.get(device, ())
        ranks = []
        for queue in self._queues.values():  # the farm's inner loop: once for each lease
            head, frames = queue.head, queue.sources
            at_hand = head.scene in loaded or (len(frames) > 1 and any(s.scene in loaded for s in frames))
            gain = head.gain * AFFINITY if at_hand else head.gain
            ranks.append((-head.priority, -gain, queue.arrived, at_hand, frames))
        ranks.sort()
        ordered: list[S] = []
        for *_, at_hand, frames in ranks:
            # Sorting is stable: those that are loaded, then the others, each in the order in which they came.
            by_turns = at_hand and len(frames) > 1
            ordered += sorted(frames, key=lambda s: s.scene not in loaded) if by_turns else frames
        return ordered

    def gave(self, device: str, source: S) -> None:
        """The device has a lease of this source, and so loads its scene, if it has to."""
        loaded = self._loaded.setdefault(device, OrderedDict())
        loaded[source.scene] = None
        loaded.move_to_end(source.scene)
        while len(loaded) > SCENES_KEPT:
            loaded.popitem(last=False)

    def forget(self, device: str) -> None:
        """The device's process has ended: nothing is loaded any more."""
        self._loaded.pop(device, None)
