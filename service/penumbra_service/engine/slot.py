"""One device of the local engine: its process, the leases that it has, and how it is started again after a
crash."""

from __future__ import annotations

import logging
import signal
import subprocess
import time
from collections import OrderedDict
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Final

from penumbra_scene.job import DeviceState

from penumbra_service.engine.launch import Child, start_child
from penumbra_service.engine.protocol import DeviceDescription
from penumbra_service.engine.rate import RunningRate
from penumbra_service.engine.sources import Held

log = logging.getLogger(__name__)

SCENE_SECONDS: Final = 900.0
"""A device may take so long to load a scene: decoding, building trees over 50 million triangles,
compiling."""
START_SECONDS: Final = 120.0
"""A process may take so long to say Hello."""
START_ATTEMPTS: Final = 3
"""Processes in a row that may end before they say Hello, until the device counts as lost."""
RETRY_SECONDS: Final = (0.0, 1.0, 5.0, 60.0)
"""Waits before start attempt 1, 2, 3 in a row, and all later ones."""


class DeviceSlot:
    """Owned by the engine's thread. Reads of plain fields from other threads are snapshots."""

    def __init__(self, description: DeviceDescription, command: Sequence[str]) -> None:
        self.description = description
        self.process: subprocess.Popen[bytes] | None = None
        self.connection: Connection | None = None
        self.held: OrderedDict[str, Held] = OrderedDict()
        self.running: str | None = None
        """The lease that the process works on."""
        self.waiting: set[str] = set()
        """Leases whose program is being compiled beside the device."""
        self.ready = False
        self.failures = 0
        """Processes in a row that ended before they said Hello."""
        self.start_at = 0.0
        self.deadline: float | None = None
        self.leases_done = 0
        self.crashes = 0
        self.rate = RunningRate()
        self.last_reason = ""
        self._command = command
        self._child: Child | None = None

    @property
    def lost(self) -> bool:
        """Whether it failed to start so often that nobody should wait for it."""
        return self.failures >= START_ATTEMPTS

    @property
    def state(self) -> DeviceState:
        if self.lost:
            return DeviceState.LOST
        if not self.ready:
            return DeviceState.STARTING
        return DeviceState.BUSY if self.held else DeviceState.IDLE

    @property
    def in_flight(self) -> int:
        """Leases that keep the device busy."""
        return len(self.held) - len(self.waiting)

    def awaits(self, scene: str) -> bool:
        """Whether a lease waits for this scene's program: more of its leases would only wait as well."""
        return any(self.held[lease].source.scene == scene for lease in self.waiting)

    def start(self) -> None:
        """Begin a process; it says Hello when the device is open. Raises OSError."""
        self.adopt(start_child(self._command, "--device", self.description.id))

    def adopt(self, child: Child) -> None:
        """Take over a process that opens this device."""
        self._child = child
        self.process, self.connection = child.process, child.connection
        self.deadline = time.monotonic() + START_SECONDS

    def send(self, held: Held) -> None:
        """Hand over a lease. Raises OSError where the process is gone."""
        assert self.connection is not None
        self.held[held.lease.id] = held
        if self.deadline is None:
            self._allow(held.lease.id, SCENE_SECONDS)
        self.connection.send(held.lease)

    def greeted(self, description: DeviceDescription) -> None:
        """The process has opened its device."""
        self.description = description
        self.ready = True
        self.failures = 0
        self.deadline = None

    def begun(self, lease_id: str) -> None:
        """The process has turned to a lease; it may have to load the scene first."""
        self.running = lease_id
        self.waiting.discard(lease_id)
        self._allow(lease_id, SCENE_SECONDS)

    def put_off(self, lease_id: str) -> None:
        """The process has put the lease aside until its program is there."""
        self.running = None
        if lease_id in self.held:
            self.waiting.add(lease_id)

    def loaded(self) -> None:
        """The scene of the running lease is on the device."""
        if self.running is not None:
            self._allow(self.running, 0.0)

    def answered(self, lease_id: str) -> Held | None:
        """The process is through with a lease."""
        self.running = None
        self.deadline = None
        self.leases_done += 1
        held = self.held.pop(lease_id, None)
        self.waiting.discard(lease_id)
        if self.held:
            self._allow(next(iter(self.held)), SCENE_SECONDS)
        return held

    def overdue(self, now: float) -> bool:
        """Whether the process hangs."""
        return self.process is not None and self.deadline is not None and now > self.deadline

    def end(self, reason: str | None = None) -> str:
        """Make sure that the process is gone; say why it is. `reason`: why it was killed, None where it ended
        by itself."""
        assert self.process is not None
        assert self.connection is not None
        if reason is not None:
            self.process.kill()
        code = self._wait()
        why = reason or _how_it_ended(code)
        words = self._last_words()
        self.last_reason = f"the process of device {self.description.id} {why}" + (
            f": {words}" if words else ""
        )
        self.connection.close()
        self.process = self.connection = self.deadline = self.running = None
        self.waiting.clear()
        if self.ready:
            self.crashes += 1
        else:
            self.failures += 1
        self.ready = False
        self.start_at = time.monotonic() + RETRY_SECONDS[min(self.failures, len(RETRY_SECONDS) - 1)]
        return self.last_reason

    def close(self, patience: float) -> None:
        """End the process for good: ask, then kill."""
        if self.process is None or self.connection is None:
            return
        try:
            if not self.held:
                self.connection.send(None)
                self.process.wait(patience)
        except (OSError, subprocess.TimeoutExpired):
            pass
        self.process.kill()
        self.process.wait()
        self.connection.close()
        if self._child is not None:
            self._child.words.close()

    def _allow(self, lease_id: str, more: float) -> None:
        held = self.held.get(lease_id)
        seconds = held.lease.deadline_seconds if held else 0.0
        self.deadline = time.monotonic() + seconds + more

    def _wait(self) -> int:
        assert self.process is not None
        try:
            return self.process.wait(5.0)
        except subprocess.TimeoutExpired:  # it closed its socket but lives on
            self.process.kill()
            return self.process.wait()

    def _last_words(self) -> str:
        if self._child is None:
            return ""
        words = self._child.last_words()
        self._child.words.close()
        self._child = None
        if words:
            log.warning("device %s said: %s", self.description.id, words)
        return words


def _how_it_ended(code: int) -> str:
    if code < 0:
        try:
            return f"was ended by {signal.Signals(-code).name}"
        except ValueError:
            return f"was ended by signal {-code}"
    return f"ended with code {code}"
