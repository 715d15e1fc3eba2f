"""The engine of a farm: devices of other processes and machines, reached through a Dask scheduler.

Implements protocol.Engine. One thread runs an event loop and all that is here. It chooses whose lease goes to which
device. Dask's scheduler says who is there; a lease goes to its worker, and the answer comes back, on a connection of their
own (channel.py), so that there is no task to be scheduled, stolen or suspected of killing its worker.

Whatever is lost on the way (a worker, the scheduler, a connection) comes back to the job as LeaseLost, unblamed: the
lease is issued again and the picture has the same bits.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from pathlib import Path
from typing import Any, Final

from distributed import Client
from penumbra_scene.job import DeviceStatus

from penumbra_service.engine.dask.addresses import check_scheduler, security
from penumbra_service.engine.dask.channel import Channel, open_channel
from penumbra_service.engine.dask.config import settle
from penumbra_service.engine.dask.publisher import Publisher
from penumbra_service.engine.dask.remote import PING_SECONDS, Carried, RemoteDevice
from penumbra_service.engine.dask.wire import Answer, FarmLease, Joined, NotPortableError
from penumbra_service.engine.protocol import (
    DeviceDescription,
    LeaseFailure,
    LeaseLost,
    LeaseResult,
    LeaseSource,
    SceneLoaded,
)
from penumbra_service.engine.snapshot import kernel_hash
from penumbra_service.engine.sources import LeaseSources
from penumbra_service.jobs.dispatch import IN_FLIGHT

log = logging.getLogger(__name__)

CONNECT_SECONDS: Final = 10.0
RETRY_SECONDS: Final = 1.0
"""Wait before the scheduler is looked for again."""
TICK_SECONDS: Final = 0.5
"""How often quiet workers and the connection are looked at."""
JOIN_SECONDS: Final = 180.0
"""A worker may take so long to say what it drives."""


class _LeftOutError(Exception):
    """A worker that this service cannot use."""


class DaskEngine:
    """`scheduler`: tls://host:port, or tcp:// on this machine; `contents`: URL of the store that workers fetch scenes
    from; `tls`: folder of certificates. Raises SettingsError for an address that may not be used."""

    def __init__(self, scheduler: str, contents: str, tls: Path | None = None) -> None:
        settle()
        self._scheduler = check_scheduler(scheduler, tls)
        self._security = security(tls if scheduler.startswith("tls:") else None, "client")
        self._publisher = Publisher(contents)
        self._sources = LeaseSources()
        self._devices: dict[str, RemoteDevice] = {}
        self._members: dict[str, asyncio.Task[None]] = {}
        """Who keeps up the connection to each worker, by its address."""
        self._tasks: set[asyncio.Task[Any]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._woken: asyncio.Event | None = None
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._connected = False
        self._failed: str | None = None

    def start(self) -> None:
        """Look for the scheduler; returns at once. Attached jobs wait for workers."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="penumbra-farm", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Leave the farm; its workers stay. Leases under way are lost, which costs their work and nothing else."""
        self._stopping = True
        self.wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def __enter__(self) -> DaskEngine:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def attach(self, source: LeaseSource) -> None:
        """Start to ask a job for leases."""
        self._sources.attach(source)
        self.wake()

    def detach(self, source: LeaseSource) -> None:
        """Ask it no more; answers to its leases are thrown away."""
        self._sources.detach(source)

    def wake(self) -> None:
        """Jobs may have new leases."""
        loop, woken = self._loop, self._woken
        if loop is not None and woken is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(woken.set)

    def usable(self) -> list[DeviceDescription]:
        """Devices that are up."""
        return [device.description for device in list(self._devices.values()) if not device.hung]

    def devices(self) -> list[DeviceStatus]:
        """Every device as it stands."""
        return [device.status for device in list(self._devices.values())]

    @property
    def problem(self) -> str | None:
        """Why nothing can be rendered now, if so. Jobs wait: a scheduler and workers may come yet."""
        if self._failed is not None:
            return self._failed
        if not self._connected:
            return f"the scheduler at {self._scheduler} does not answer"
        return None if self._devices else f"the scheduler at {self._scheduler} has no worker yet"

    def _run(self) -> None:
        try:
            asyncio.run(self._stay_connected())
        except Exception:
            log.exception("the farm engine's thread ended")
            self._failed = "the engine failed; its log says why"
            self._sources.give_up(self._failed)

    async def _stay_connected(self) -> None:
        self._loop, self._woken = asyncio.get_running_loop(), asyncio.Event()
        while not self._stopping:
            try:
                async with Client(
                    self._scheduler,
                    asynchronous=True,
                    security=self._security,
                    set_as_default=False,
                    timeout=CONNECT_SECONDS,
                    name="penumbra",
                ) as client:
                    await self._session(client)
            except (OSError, TimeoutError) as error:
                log.warning("the scheduler at %s: %s", self._scheduler, error)
            self._connected = False
            for address in list(self._members):
                self._part(address, "the connection to the scheduler was lost")
            if not self._stopping:
                await asyncio.sleep(RETRY_SECONDS)

    async def _session(self, client: Client) -> None:
        """Until the scheduler is gone or the engine stops."""
        assert self._woken is not None
        client.subscribe_topic("all", lambda event: self._membership(client, event[1]))
        known = await client.scheduler.identity(n_workers=-1)
        log.info("connected to the scheduler at %s: %d workers", self._scheduler, len(known["workers"]))
        self._connected = True
        for address in known["workers"]:
            self._join(client, address)
        while not self._stopping and client.status == "running":
            self._feed()
            self._ping_quiet(client)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._woken.wait(), TICK_SECONDS)
            self._woken.clear()
        if client.status == "running":
            client.unsubscribe_topic("all")

    def _membership(self, client: Client, event: dict[str, Any]) -> None:
        """A worker has come or gone."""
        address = event.get("worker")
        if event.get("action") == "add-worker" and address:
            self._join(client, address)
        elif event.get("action") == "remove-worker" and address:
            self._part(address, "it has gone")

    def _join(self, client: Client, address: str) -> None:
        if address not in self._members:
            self._members[address] = self._spawn(self._keep(client, address))

    def _part(self, address: str, reason: str) -> None:
        """A worker is no member any more."""
        member = self._members.pop(address, None)
        if member is not None:
            member.cancel()
        if address in self._devices:
            self._lose(self._devices[address], reason)

    async def _keep(self, client: Client, address: str) -> None:
        """Hold the connection to a worker for as long as it is a member."""
        while True:
            try:
                await self._hold(client, address)
            except _LeftOutError as error:
                log.warning("%s", error)
                return
            except Exception as error:  # whatever it says: the others are to be served
                log.warning("worker %s: %s: %s", address, type(error).__name__, error)
            await asyncio.sleep(RETRY_SECONDS)

    async def _hold(self, client: Client, address: str) -> None:
        """Take a worker in and hear what it says, until the connection ends. Raises _LeftOutError, OSError."""
        channel = await open_channel(address, client.connection_args)
        device = None
        try:
            device = RemoteDevice(address, await self._greet(channel), channel)
            self._devices[address] = device
            log.info("worker %s has joined", device.description.id)
            self.wake()
            while True:
                self._hear(device, await channel.receive())
        finally:
            channel.abort()
            if device is not None and self._devices.get(address) is device:
                self._lose(device, "the connection has ended")

    async def _greet(self, channel: Channel) -> DeviceDescription:
        """What a worker drives, if its kernels are ours."""
        joined: Joined = await asyncio.wait_for(channel.receive(), JOIN_SECONDS)
        if joined.kernel_hash != kernel_hash():
            raise _LeftOutError(
                f"worker {joined.device.id} is left out: its kernels (version {joined.version}) are not those of this service"
            )
        return joined.device

    def _feed(self) -> None:
        # One lease each in turn, so that the last ones spread over the devices.
        for _ in range(IN_FLIGHT):
            for device in list(self._devices.values()):
                if not device.hung and len(device.held) < IN_FLIGHT:
                    self._feed_one(device)

    def _feed_one(self, device: RemoteDevice) -> None:
        held = self._sources.take(device.description)
        if held is None:
            return
        if not device.held:
            device.hear()  # silence counts from now on
        carried = device.held[held.lease.id] = Carried(held.lease, held.source)
        carried.task = self._spawn(self._carry(device, carried))

    async def _carry(self, device: RemoteDevice, carried: Carried) -> None:
        """Take a lease to its worker."""
        try:
            contents = await self._publisher.contents_of(carried.lease.spec)
        except (OSError, NotPortableError) as error:
            kind = "storage" if isinstance(error, OSError) else "scene"
            self._answered(
                device, LeaseFailure(carried.lease.id, kind, f"the scene cannot be published: {error}")
            )
            return
        try:
            await device.channel.send(FarmLease(carried.lease, contents))
        except OSError as error:
            reason = f"the worker of device {device.description.id} is out of reach: {error}"
            self._answered(device, LeaseLost(carried.lease.id, device.description.id, False, reason))

    def _hear(self, device: RemoteDevice, message: SceneLoaded | Answer) -> None:
        if not isinstance(message, SceneLoaded):
            self._answered(device, message)
            return
        device.hear()
        source = next((c.source for c in device.held.values() if c.lease.job == message.job), None)
        if source is not None:
            self._sources.deliver(source, device.description, message)

    def _answered(self, device: RemoteDevice, answer: Answer) -> None:
        device.hear()
        carried = device.held.pop(answer.lease, None)
        self.wake()
        if carried is None:
            return
        if isinstance(answer, LeaseLost):
            device.crashes += answer.blamed
            blamed = answer.lease if answer.blamed else None
            self._sources.lose([carried], device.description, answer.reason, blamed)
            return
        if isinstance(answer, LeaseFailure):
            self._publisher.forget(carried.lease.spec)
        if isinstance(answer, LeaseResult):
            device.leases_done += 1
            device.rate.measure(answer)
        self._sources.answer(carried, device.description, answer)

    def _ping_quiet(self, client: Client) -> None:
        now = time.monotonic()
        for device in self._devices.values():
            if device.wants_ping(now, len(self._devices)):
                device.heard = now  # the next question comes no earlier
                self._spawn(self._ping(client, device))

    async def _ping(self, client: Client, device: RemoteDevice) -> None:
        """Our own look at a worker: the scheduler's takes five minutes unless it is told otherwise."""
        try:
            await asyncio.wait_for(client.rpc(device.address).identity(), PING_SECONDS)
        except (OSError, TimeoutError):
            device.unanswered += 1
        else:
            device.hear()
            return
        if device.hung and device.held:
            log.warning("worker %s does not answer", device.description.id)
            self._take_back(device, f"the worker of device {device.description.id} did not answer in time")

    def _lose(self, device: RemoteDevice, reason: str) -> None:
        """A worker is out of reach: its leases go back to their jobs."""
        if not self._stopping:
            log.warning("worker %s: %s", device.description.id, reason)
        self._devices.pop(device.address, None)
        self._take_back(device, f"the worker of device {device.description.id} is out of reach: {reason}")

    def _take_back(self, device: RemoteDevice, reason: str) -> None:
        held = list(device.held.values())
        device.held.clear()
        for carried in held:
            if carried.task is not None:
                carried.task.cancel()
        self._sources.lose(held, device.description, reason)

    def _spawn(self, work: Any) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
