"""The engine of one machine: a child process for each OpenCL device, fed two leases at a time, replaced when
it dies.

The driver can abort its process and stalls its other threads while it compiles; so none of it happens here.
One thread owns all processes and sockets. It calls jobs (LeaseSource) only for a lease or with news, never
while holding a lock.
"""

from __future__ import annotations

import json
import logging
import subprocess
import threading
import time
from collections.abc import Sequence
from multiprocessing import Pipe
from multiprocessing.connection import wait
from typing import Any, Final

from penumbra_scene.job import DeviceStatus

from penumbra_service.engine.launch import DEVICE_COMMAND, Child, start_first
from penumbra_service.engine.protocol import (
    DeviceDescription,
    Devices,
    FromDevice,
    Hello,
    LeaseFailure,
    LeaseResult,
    LeaseSource,
    SceneLoaded,
    Started,
    Waiting,
)
from penumbra_service.engine.slot import DeviceSlot
from penumbra_service.engine.sources import LeaseSources
from penumbra_service.engine.status import device_status
from penumbra_service.jobs.dispatch import IN_FLIGHT

log = logging.getLogger(__name__)

LIST_SECONDS: Final = 120.0
"""Drivers may take long to count their devices, the first time."""
TICK_SECONDS: Final = 0.5
"""How often deadlines and restarts are looked at."""
CLOSE_SECONDS: Final = 2.0


class NoDeviceError(RuntimeError):
    """This machine has no usable OpenCL device; the message says why."""


def list_devices(command: Sequence[str] = DEVICE_COMMAND) -> list[DeviceDescription]:
    """The machine's OpenCL devices, asked for in a process of its own. Raises NoDeviceError where that
    fails."""
    try:
        done = subprocess.run(
            [*command, "--list"],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=LIST_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise NoDeviceError(f"listing the OpenCL devices took more than {LIST_SECONDS:g} s") from error
    lines = done.stdout.strip().splitlines()
    if done.returncode != 0 or not lines:
        raise NoDeviceError(
            f"listing the OpenCL devices failed ({done.returncode}): {done.stderr.strip()[-2000:]}"
        )
    found: list[dict[str, Any]] = json.loads(lines[-1])
    return [DeviceDescription(**device) for device in found]


class LocalEngine:
    """Implements protocol.Engine. `device_ids`: which devices to use, all by default. `first`: launch.start_first's process
    for the same ids, where that was started ahead."""

    def __init__(
        self,
        device_ids: Sequence[str] | None = None,
        *,
        command: Sequence[str] = DEVICE_COMMAND,
        first: Child | None = None,
    ) -> None:
        self._device_ids = device_ids
        self._command = tuple(command)
        self._first = first
        self._slots: list[DeviceSlot] = []
        self._sources = LeaseSources()
        self._waking = threading.Lock()
        self._wake_reader, self._wake_writer = Pipe(duplex=False)
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._known = threading.Event()
        self._problem: str | None = None

    def start(self) -> None:
        """Look for devices and start their processes; returns at once. Attached jobs wait for them."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="penumbra-engine", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End all device processes. Leases under way are lost, which costs their work and nothing else."""
        self._stopping = True
        self.wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def __enter__(self) -> LocalEngine:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def attach(self, source: LeaseSource) -> None:
        """Start to ask a job for leases. Where there is no device, it hears of it as soon as that is
        known."""
        self._sources.attach(source)
        self.wake()

    def detach(self, source: LeaseSource) -> None:
        """Ask it no more; answers to its leases are thrown away."""
        self._sources.detach(source)

    def wake(self) -> None:
        """Jobs may have new leases."""
        if self._thread is not None and self._thread.is_alive():
            with self._waking:
                self._wake_writer.send_bytes(b".")

    def wait_known(self, timeout: float | None = None) -> list[DeviceDescription]:
        """Wait until the machine's devices have been listed. Raises NoDeviceError where there are none."""
        if not self._known.wait(timeout):
            raise NoDeviceError("the devices have not been listed yet")
        if self._problem is not None:
            raise NoDeviceError(self._problem)
        return self.usable()

    def usable(self) -> list[DeviceDescription]:
        """Devices that are up, or may come up again."""
        return [slot.description for slot in self._slots if not slot.lost]

    def devices(self) -> list[DeviceStatus]:
        """Every device as it stands."""
        return [_status(slot) for slot in self._slots]

    @property
    def problem(self) -> str | None:
        """Why there is no device at all, if so."""
        return self._problem

    def _run(self) -> None:
        try:
            self._find()
            while not self._stopping:
                self._start_due()
                self._feed()
                self._listen()
                self._kill_overdue()
        except Exception:
            log.exception("the engine's thread ended")
            self._problem = "the engine failed; its log says why"
            self._sources.give_up(self._problem)
        finally:
            self._known.set()
            if self._first is not None:
                self._first.end()
            for slot in self._slots:
                slot.close(CLOSE_SECONDS)

    def _find(self) -> None:
        try:
            told = self._meet()
            found = told.devices
            wanted = [d for d in found if self._device_ids is None or d.id in self._device_ids]
            missing = sorted(set(self._device_ids or ()) - {d.id for d in found})
            if missing:
                have = ", ".join(d.id for d in found) or "none"
                raise NoDeviceError(f"no OpenCL device {', '.join(missing)}; this machine has: {have}")
            if not wanted:
                raise NoDeviceError("this machine has no OpenCL device")
            self._slots = [DeviceSlot(device, self._command) for device in wanted]
            for slot in self._slots:
                if slot.description.id == told.opening and self._first is not None:
                    slot.adopt(self._first)
                    self._first = None
        except NoDeviceError as error:
            self._problem = str(error)
            log.info("%s", error)  # whoever waits for devices raises it, and a service tells it in /health
        self._known.set()

    def _meet(self) -> Devices:
        """What the first process tells. Raises NoDeviceError."""
        try:
            first = self._first = self._first or start_first(self._device_ids, self._command)
            deadline = time.monotonic() + LIST_SECONDS
            while not first.connection.poll(TICK_SECONDS):
                if self._stopping:
                    raise NoDeviceError("the engine was stopped")
                if time.monotonic() > deadline:
                    raise NoDeviceError(f"listing the OpenCL devices took more than {LIST_SECONDS:g} s")
            message = first.connection.recv()
        except EOFError:
            code = first.process.wait()
            raise NoDeviceError(f"listing the OpenCL devices failed ({code}): {first.last_words()}") from None
        except OSError as error:
            raise NoDeviceError(f"listing the OpenCL devices failed: {error}") from error
        assert isinstance(message, Devices)
        return message

    def _start_due(self) -> None:
        now = time.monotonic()
        for slot in self._slots:
            if slot.process is None and now >= slot.start_at:
                try:
                    slot.start()
                except OSError as error:  # no more processes or descriptors
                    slot.failures += 1
                    slot.start_at = now + 5.0
                    slot.last_reason = f"the process of device {slot.description.id} cannot start: {error}"

    def _feed(self) -> None:
        if not len(self._sources):
            return
        if all(slot.lost for slot in self._slots):
            reasons = "; ".join(slot.last_reason for slot in self._slots)
            self._sources.give_up(self._problem or reasons)
            return
        # One lease each in turn, so that the last ones spread over the devices.
        for _ in range(IN_FLIGHT):
            for slot in self._slots:
                if slot.ready and slot.in_flight < IN_FLIGHT:
                    self._feed_one(slot)

    def _feed_one(self, slot: DeviceSlot) -> None:
        held = self._sources.take(slot.description, slot.awaits)
        if held is None:
            return
        try:
            slot.send(held)
        except OSError:
            self._ended(slot)

    def _listen(self) -> None:
        by_connection = {slot.connection: slot for slot in self._slots if slot.connection is not None}
        for ready in wait([self._wake_reader, *by_connection], TICK_SECONDS):
            if ready is self._wake_reader:
                while self._wake_reader.poll():
                    self._wake_reader.recv_bytes()
                continue
            slot = by_connection[ready]  # type: ignore[index]
            if slot.connection is ready:
                self._read(slot)

    def _read(self, slot: DeviceSlot) -> None:
        assert slot.connection is not None
        try:
            message: FromDevice = slot.connection.recv()
        except (EOFError, OSError):
            self._ended(slot)
            return
        self._take(slot, message)

    def _take(self, slot: DeviceSlot, message: FromDevice) -> None:
        match message:
            case Hello(device):
                slot.greeted(device)
            case Started(lease):
                slot.begun(lease)
            case Waiting(lease):
                slot.put_off(lease)
            case SceneLoaded():
                held = slot.held.get(slot.running or "")
                slot.loaded()
                if held is not None:
                    self._sources.deliver(held.source, slot.description, message)
            case LeaseResult(lease) | LeaseFailure(lease):
                held = slot.answered(lease)
                if held is not None:
                    if isinstance(message, LeaseResult):
                        slot.rate.measure(message)
                    self._sources.answer(held, slot.description, message)
            case _:
                pass

    def _kill_overdue(self) -> None:
        now = time.monotonic()
        for slot in self._slots:
            if slot.overdue(now):
                self._ended(slot, "did not answer in time and was killed")

    def _ended(self, slot: DeviceSlot, reason: str | None = None) -> None:
        """A device's process is gone, or hangs: its leases go back, and another process will start."""
        running = slot.running
        why = slot.end(reason)
        log.warning("%s", why, extra={"device": slot.description.id})
        held = list(slot.held.values())
        slot.held.clear()
        self._sources.lose(held, slot.description, why, blamed=running)


def _status(slot: DeviceSlot) -> DeviceStatus:
    held = next(iter(slot.held.values()), None)
    return device_status(
        slot.description,
        slot.state,
        job=held.lease.job if held else None,
        leases_done=slot.leases_done,
        crashes=slot.crashes,
        samples_per_second=slot.rate.samples_per_second,
    )
