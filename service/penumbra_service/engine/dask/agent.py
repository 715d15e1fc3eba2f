"""Between the services of a farm and the one device of a worker.

The device lives in a child process, as in the local engine and by the same code: its driver may abort or hang without
taking the worker out of the farm, the job hears why, and the worker's event loop answers while a kernel compiles.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Coroutine, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from distributed import Status, Worker
from distributed.comm import Comm

from penumbra_service.engine.dask.channel import OPERATION, Channel
from penumbra_service.engine.dask.wire import Answer, Contents, FarmLease, Joined
from penumbra_service.engine.launch import DEVICE_COMMAND
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.protocol import (
    DeviceDescription,
    Lease,
    LeaseFailure,
    LeaseLost,
    LeaseResult,
    NoDevice,
    RenderSpec,
    SceneLoaded,
    ToJob,
)
from penumbra_service.engine.snapshot import kernel_hash
from penumbra_service.store.contents import ContentStore, trim

SCENES_REMEMBERED: Final = 64
KNOWN_SECONDS: Final = 120.0
"""Listing devices may take so long at a worker's start."""


class _Service:
    """One that has connected."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.told: set[tuple[str, str]] = set()
        """(job, spec): what was told to be loaded."""
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()

    def tell(self, loaded: SceneLoaded) -> None:
        """From any thread; what is told first is heard first."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self.spawn, self.send(loaded))

    async def send(self, message: SceneLoaded | Answer) -> None:
        with contextlib.suppress(OSError):  # it has gone: it issues its leases again
            await self.channel.send(message)

    def spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


@dataclass
class _Waiting:
    lease: Lease
    answer: Future[Answer]
    service: _Service


class Agent:
    """Implements protocol.LeaseSource for the worker's own LocalEngine."""

    job = "farm"
    scene = ""
    priority = 0
    gain = 1.0

    def __init__(
        self,
        device_id: str,
        name: str,
        cache: Path,
        *,
        cache_bytes: int,
        contents: str | None = None,
        command: Sequence[str] = DEVICE_COMMAND,
        on_lost: Callable[[str], None] = lambda reason: None,
    ) -> None:
        """`contents` overrides where leases say that scenes lie; `on_lost` is called when the device cannot be
        started any more."""
        self._name = name
        self._cache = cache
        self._cache_bytes = cache_bytes
        self._contents = contents
        self._on_lost = on_lost
        self._lock = threading.Lock()
        self._ready: deque[_Waiting] = deque()
        self._held: dict[str, _Waiting] = {}
        self._fetching = threading.Lock()
        self._loaded: OrderedDict[str, SceneLoaded] = OrderedDict()
        """By spec, what loading it was like: services that come later hear it too."""
        self._stores: dict[str, ContentStore] = {}
        self._engine = LocalEngine([device_id], command=command)

    def start(self) -> None:
        """Open the device; returns at once."""
        self._engine.start()
        self._engine.attach(self)

    def stop(self) -> None:
        """End the device's process."""
        self._engine.stop()

    def describe(self) -> Joined:
        """Raises NoDeviceError."""
        device = self._engine.wait_known(KNOWN_SECONDS)[0]
        mine = replace(device, id=f"{device.id}@{self._name}")
        return Joined(mine, kernel_hash(), metadata.version("penumbra-render"))

    def join(self, worker: Worker) -> None:
        """Take leases from every service that connects to this Dask worker."""
        worker.handlers[OPERATION] = self.serve

    async def serve(self, comm: Comm) -> Status:
        """A service's connection: tell it what this worker drives, then take its leases and answer each, until it goes."""
        service = _Service(Channel(comm))
        try:
            await service.channel.send(await asyncio.to_thread(self.describe))
            while True:
                service.spawn(self._work(await service.channel.receive(), service))
        except OSError:  # it has gone
            comm.abort()
        return Status.dont_reply

    async def _work(self, farm: FarmLease, service: _Service) -> None:
        """Do a lease and answer it."""
        lease = farm.lease
        try:
            spec = await asyncio.to_thread(self._fetch, lease.spec, farm.contents)
        except OSError as error:  # this worker's trouble: another may reach the store
            await service.send(LeaseFailure(lease.id, "device", f"the scene cannot be fetched: {error}"))
            return
        waiting = _Waiting(replace(lease, spec=spec), Future(), service)
        whose = (lease.job, spec.key)
        with self._lock:
            self._ready.append(waiting)
            loaded = None if whose in service.told else self._loaded.get(spec.key)
            service.told.add(whose)
        if loaded is not None:
            service.tell(_warm(loaded, lease.job))
        self._engine.wake()
        answer: Answer = await asyncio.wrap_future(waiting.answer)
        await service.send(answer)

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """What a service has sent (engine's thread)."""
        with self._lock:
            if not self._ready:
                return None
            waiting = self._ready.popleft()
            self._held[waiting.lease.id] = waiting
        return waiting.lease

    def deliver(self, device: DeviceDescription, event: ToJob) -> None:
        """News of the device (engine's thread)."""
        match event:
            case LeaseResult(lease) | LeaseFailure(lease) | LeaseLost(lease):
                with self._lock:
                    waiting = self._held.pop(lease, None)
                if waiting is not None:
                    waiting.answer.set_result(event)
            case SceneLoaded(job):
                with self._lock:
                    waiting = next((w for w in self._held.values() if w.lease.job == job), None)
                if waiting is not None:
                    self._remember(waiting.lease.spec.key, event)
                    waiting.service.tell(event)
            case NoDevice(reason):
                self._give_up(reason)

    def _remember(self, key: str, loaded: SceneLoaded) -> None:
        with self._lock:
            self._loaded[key] = loaded
            while len(self._loaded) > SCENES_REMEMBERED:
                self._loaded.popitem(last=False)

    def _give_up(self, reason: str) -> None:
        with self._lock:
            waiting = [*self._held.values(), *self._ready]
            self._held.clear()
            self._ready.clear()
        for one in waiting:
            one.answer.set_result(LeaseLost(one.lease.id, self._name, False, reason))
        self._on_lost(reason)

    def _fetch(self, spec: RenderSpec, contents: Contents) -> RenderSpec:
        """The spec with paths of this machine. Raises OSError."""
        assets = self._cache / "assets"
        with self._fetching:
            store = self._store(self._contents or contents.url)
            assets.mkdir(parents=True, exist_ok=True)
            scene = store.fetch(contents.scene, self._cache / "scenes")
            files = []
            for sha256 in contents.assets:
                # Loading the scene tells of a missing one in the words of a local device.
                with contextlib.suppress(FileNotFoundError):
                    files.append(store.fetch(sha256, assets))
            trim(assets, self._cache_bytes, files)
            trim(self._cache / "scenes", self._cache_bytes, [scene])
        return replace(spec, scene_path=str(scene), assets_folder=str(assets))

    def _store(self, url: str) -> ContentStore:
        if url not in self._stores:
            self._stores[url] = ContentStore(url)
        return self._stores[url]


def _warm(loaded: SceneLoaded, job: str) -> SceneLoaded:
    """For a job that finds the scene loaded."""
    return replace(
        loaded, job=job, build_seconds=0.0, build_warm=True, compile_seconds=0.0, compile_warm=True
    )
