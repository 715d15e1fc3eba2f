"""One device of the farm as the service sees it: its worker, the leases that it has, and when it was last heard."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final

from penumbra_scene.job import DeviceState, DeviceStatus

from penumbra_service.engine.dask.channel import Channel
from penumbra_service.engine.protocol import DeviceDescription
from penumbra_service.engine.rate import RunningRate
from penumbra_service.engine.sources import Held
from penumbra_service.engine.status import device_status

QUIET_SECONDS: Final = 5.0
"""A worker that has leases and says nothing for so long is asked whether it lives."""
PINGS_PER_SECOND: Final = 50
"""That one service asks, of all its workers together: those of a large farm are asked later."""
PING_SECONDS: Final = 3.0
"""It may take so long to answer."""
PINGS: Final = 2
"""So many questions in a row without an answer: it hangs."""


@dataclass
class Carried(Held):
    """A lease on its way to a worker and back."""

    task: asyncio.Task[None] | None = None
    """Takes it there."""


@dataclass
class RemoteDevice:
    """Owned by the engine's thread. Reads of plain fields from other threads are snapshots."""

    address: str
    """Of the worker, as Dask names it."""
    description: DeviceDescription
    channel: Channel
    held: OrderedDict[str, Carried] = field(default_factory=OrderedDict)
    heard: float = field(default_factory=time.monotonic)
    unanswered: int = 0
    """Pings in a row."""
    leases_done: int = 0
    crashes: int = 0
    rate: RunningRate = field(default_factory=RunningRate)

    @property
    def hung(self) -> bool:
        """Whether it gets no leases until it answers again."""
        return self.unanswered >= PINGS

    def hear(self) -> None:
        """A sign of life."""
        self.heard = time.monotonic()
        self.unanswered = 0

    def wants_ping(self, now: float, devices: int = 1) -> bool:
        """Whether it is time to ask, as one of so many."""
        quiet = max(QUIET_SECONDS, devices / PINGS_PER_SECOND)
        return bool(self.held or self.hung) and now - self.heard > quiet

    @property
    def state(self) -> DeviceState:
        if self.hung:
            return DeviceState.LOST
        return DeviceState.BUSY if self.held else DeviceState.IDLE

    @property
    def status(self) -> DeviceStatus:
        """As the API shows it."""
        held = next(iter(self.held.values()), None)
        return device_status(
            self.description,
            self.state,
            job=held.lease.job if held else None,
            leases_done=self.leases_done,
            crashes=self.crashes,
            samples_per_second=self.rate.samples_per_second,
        )
