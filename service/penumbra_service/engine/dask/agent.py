"""Between Dask's tasks and the one device of a worker.

The device lives in a child process, as in the local engine and by the same code: its driver may abort or hang without
taking the worker out of the farm, the job hears why, and the worker's own thread answers Dask while a kernel compiles.
"""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Final

from distributed import get_worker

from penumbra_service.engine.dask.wire import Answer, Contents, FarmLease, Joined, loaded_to_event
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


@dataclass
class _Waiting:
    lease: Lease
    answer: Future[Answer]
    tell: Callable[[SceneLoaded], None]
    whose: tuple[str, str, str]
    """Service, job, spec."""


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
        self._told: set[tuple[str, str, str]] = set()
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

    def work(self, farm: FarmLease, tell: Callable[[SceneLoaded], None]) -> Answer:
        """Do a lease; blocks until it is answered."""
        lease = farm.lease
        try:
            spec = self._fetch(lease.spec, farm.contents)
        except OSError as error:  # this worker's trouble: another may reach the store
            return LeaseFailure(lease.id, "device", f"the scene cannot be fetched: {error}")
        waiting = _Waiting(replace(lease, spec=spec), Future(), tell, (farm.topic, lease.job, spec.key))
        with self._lock:
            self._ready.append(waiting)
            loaded = None if waiting.whose in self._told else self._loaded.get(spec.key)
            self._told.add(waiting.whose)
        if loaded is not None:
            tell(_warm(loaded, lease.job))
        self._engine.wake()
        return waiting.answer.result()

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """What a task has brought (engine's thread)."""
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
                    waiting.tell(event)
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
        store = ContentStore(self._contents or contents.url)
        assets = self._cache / "assets"
        with self._fetching:
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


def _warm(loaded: SceneLoaded, job: str) -> SceneLoaded:
    """For a job that finds the scene loaded."""
    return replace(
        loaded, job=job, build_seconds=0.0, build_warm=True, compile_seconds=0.0, compile_warm=True
    )


_AGENT: Agent | None = None


def set_agent(agent: Agent) -> None:
    """Whom this process's tasks work for."""
    global _AGENT
    _AGENT = agent


def _agent() -> Agent:
    if _AGENT is None:
        raise RuntimeError("this Dask worker drives no device: start it with `penumbra worker`")
    return _AGENT


def describe_worker() -> Joined:
    """A task: what does this worker drive?"""
    return _agent().describe()


def do_lease(farm: FarmLease) -> Answer:
    """A task: do a lease."""
    worker = get_worker()

    def tell(loaded: SceneLoaded) -> None:
        worker.log_event(farm.topic, loaded_to_event(worker.address, loaded))

    return _agent().work(farm, tell)
