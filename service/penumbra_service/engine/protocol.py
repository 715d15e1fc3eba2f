"""What an engine and its device processes say to each other, and what a job is to an engine. Plain picklable
values.

A device process gets RenderSpecs by reference (a path, a folder), never scenes themselves; it answers with
sum nodes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Final, Protocol

from penumbra_kernels.allotment import Allotment
from penumbra_kernels.nodes import SumNode, Tile

from penumbra_service.images.limits import DEFAULTS, DecodeLimits
from penumbra_service.jobs.dispatch import Bidder
from penumbra_service.jobs.planning import WorkItem

if TYPE_CHECKING:  # a device process does not wait for what it does not use
    from penumbra_scene.job import DeviceStatus


@dataclass(frozen=True)
class RenderSpec:
    """What a device must load to work on a job; the same key, the same bits."""

    scene_path: str
    """The scene as rendered, JSON."""
    scene_hash: str
    assets_folder: str | None
    """Assets by content."""
    scene_folder: str | None
    """What `file` references are relative to; None: they are refused."""
    time: float
    replicates: int
    strata: int
    program: str = "auto"
    """'specialised': the scene's own; 'generic': every effect compiled in; 'auto': the one that is ready first, and the own
    one from when it is there and pays off (programs.py)."""
    decode: DecodeLimits = DEFAULTS
    """On assets that have to be decoded anew."""

    @property
    def key(self) -> str:
        """Names what is to be loaded. Assets by content are the same in any folder; files beside a scene are not."""
        parts = asdict(self)
        for where in ("scene_path", "assets_folder", "decode"):
            del parts[where]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class DeviceDescription:
    """A device as it describes itself."""

    id: str
    name: str
    platform: str
    version: str
    driver: str
    kind: str
    compute_units: int
    memory_bytes: int
    bit_class: str


NOBODY: Final = DeviceDescription("", "", "", "", "", "", 0, 0, "")
"""Where no device is meant: NoDevice comes from it."""


@dataclass(frozen=True)
class Lease:
    """Work for one device."""

    id: str
    job: str
    spec: RenderSpec
    items: tuple[WorkItem, ...]
    deadline_seconds: float
    """After which the device counts as hung, from when it starts on the lease with the scene loaded."""
    allotments: Mapping[Tile, Allotment] = field(default_factory=dict)
    """Adaptive: what the pixels of the items' tiles take; those of tiles that are not in it take all."""


# From the parent to a device process: Lease, or None to end.


@dataclass(frozen=True)
class Devices:
    """The first process's first message: this machine's devices, and which it goes on to drive (None: no wanted one)."""

    devices: tuple[DeviceDescription, ...]
    opening: str | None


@dataclass(frozen=True)
class Hello:
    """The device is open."""

    device: DeviceDescription


@dataclass(frozen=True)
class Started:
    """The process turns to this lease; if it dies now, the lease is to blame."""

    lease: str


@dataclass(frozen=True)
class Waiting:
    """The lease's program is being compiled, in a process of its own; the device is free for leases of other scenes."""

    lease: str


@dataclass(frozen=True)
class SceneLoaded:
    """A job's scene is on the device, its program built; or another program has taken over."""

    job: str
    build_seconds: float
    """Decoding assets, arrays, trees, upload."""
    build_warm: bool
    """The process had it loaded already."""
    compile_seconds: float
    compile_warm: bool
    """The program came from the cache, or the process had it loaded."""
    effects: tuple[tuple[str, bool, str, str | None], ...]
    """(name, whether the scene calls for it, why, JSON pointer to what calls for it)."""
    program: str
    """'specialised' or 'generic'."""
    program_hash: str
    background_seconds: float = 0.0
    """Of building the program while another one rendered."""


@dataclass(frozen=True)
class LeaseResult:
    """All of a lease's nodes."""

    lease: str
    nodes: tuple[SumNode, ...]
    seconds: float
    """Of tracing."""
    program: str = "specialised"
    """Which one rendered it, all of it."""
    program_hash: str = ""


@dataclass(frozen=True)
class LeaseFailure:
    """The process lives, but could not do the lease. kind: 'scene' (an asset is missing or broken), 'build'
    (the compiler refused), 'device' (the driver did, or a farm's worker cannot fetch the scene), 'storage' (the service
    cannot put the scene where workers fetch it), 'internal'."""

    lease: str
    kind: str
    message: str


@dataclass(frozen=True)
class Heartbeat:
    """The process lives."""

    phase: str
    resident_bytes: int


@dataclass(frozen=True)
class LeaseLost:
    """From the engine: the device process ended with this lease. `blamed`: it was working on it."""

    lease: str
    device: str
    blamed: bool
    reason: str


@dataclass(frozen=True)
class NoDevice:
    """From the engine: nothing is left that could render."""

    reason: str


FromDevice = Devices | Hello | Started | Waiting | SceneLoaded | LeaseResult | LeaseFailure | Heartbeat
ToJob = SceneLoaded | LeaseResult | LeaseFailure | LeaseLost | NoDevice


class LeaseSource(Bidder, Protocol):
    """A job, or a frame of one, as an engine sees it. Everything is called on the engine's thread and must return
    at once; whose turn it is says jobs.dispatch.Dispatcher."""

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """Work for a device, or None."""

    def deliver(self, device: DeviceDescription, event: ToJob) -> None:
        """Something about one of this job's leases."""


class Engine(Protocol):
    """Who runs leases: LocalEngine, DaskEngine."""

    def attach(self, source: LeaseSource) -> None:
        """Start to ask a job for leases."""

    def detach(self, source: LeaseSource) -> None:
        """Ask it no more; answers to its leases are thrown away."""

    def wake(self) -> None:
        """A job has new leases."""

    def usable(self) -> list[DeviceDescription]:
        """Devices that are up, or may come up again."""


class ServedEngine(Engine, Protocol):
    """An engine that a service keeps up."""

    def start(self) -> None:
        """Returns at once; devices come up by themselves."""

    def stop(self) -> None:
        """Leases under way are lost, which costs their work and nothing else."""

    def devices(self) -> list[DeviceStatus]:
        """Every device as it stands."""

    @property
    def problem(self) -> str | None:
        """Why nothing can be rendered now, if so."""
