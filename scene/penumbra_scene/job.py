"""Jobs as they cross HTTP: what is asked, how it stands, and lists and events of it."""

from __future__ import annotations

from datetime import datetime
from enum import StrEnum
from typing import Annotated, Final, Literal

from pydantic import Field, StringConstraints, model_validator

from penumbra_scene.adaptive import Adaptive, in_force
from penumbra_scene.base import (
    Bool,
    Float,
    Integer,
    Measured,
    Model,
    Name,
    NotBoolean,
    Positive,
    Unit,
    error_at,
)
from penumbra_scene.errors import Problem
from penumbra_scene.film import Film
from penumbra_scene.frames import ACCEPTED, PATTERN, FramesError, is_range, parse_frames
from penumbra_scene.scene import Scene
from penumbra_scene.settings import Integrator, Sampler, Stop

JobId = Annotated[str, StringConstraints(pattern=r"^[0-9A-Za-z_-]{1,64}$")]
Count = Annotated[int, Field(ge=0), NotBoolean]


class JobRequest(Model):
    """A scene to render, and settings that take the place of the scene's own."""

    scene: Scene
    name: Name | None = None
    """Default: the scene's name."""
    priority: Annotated[int, Field(ge=-100, le=100), NotBoolean] = 0
    """Higher ones go first."""
    frames: Annotated[str, StringConstraints(pattern=PATTERN, max_length=1000)] | None = None
    """What to render: one frame such as "12", the scene at the time frame / fps; or ranges and lists of frames,
    "1-240", "1-240x2" (every second one), "1,5,10-20", each of which becomes a picture of its own. Null is the scene
    at time 0."""
    fps: Annotated[Positive, Field(le=1000)] = 24.0
    """Frames a second."""
    strict: Bool = False
    """Only devices of one bit class work on it, that of the first, so that the picture has the same bits again on any
    device of that class; otherwise all do, and the receipt says 'mixed' if there were several."""
    film: Film | None = None
    """Takes the place of the scene's whole section, as do the next four."""
    sampler: Sampler | None = None
    integrator: Integrator | None = None
    adaptive: Adaptive | None = None
    stop: Stop | None = None
    measure_effects: Bool = False
    """Say in the receipt what each effect cost in seconds and in noise. Takes a few seconds more, after the render."""

    @model_validator(mode="after")
    def _frames_exist(self) -> JobRequest:
        try:
            parse_frames(self.frames or "0")
        except FramesError as error:
            raise error_at("/frames", str(error), ACCEPTED) from None
        return self

    @property
    def sequence(self) -> tuple[int, ...]:
        """The frames of a job that makes several pictures; empty where it makes one."""
        return parse_frames(self.frames) if self.frames is not None and is_range(self.frames) else ()

    @property
    def time(self) -> float:
        """Seconds: when the scene is looked at; for a sequence, its first frame."""
        return 0.0 if self.frames is None else self.time_of(parse_frames(self.frames)[0])

    def time_of(self, frame: int) -> float:
        """Seconds: when a frame looks at the scene."""
        return frame / self.fps

    def resolved_scene(self) -> Scene:
        """The scene as it will be rendered, with this request's sections in place of its own."""
        given = {key: getattr(self, key) for key in OVERRIDES}
        sections = {key: value for key, value in given.items() if value is not None}
        if "adaptive" in sections:
            sections["adaptive"] = in_force(sections["adaptive"])
        return self.scene.model_copy(update=sections)


class JobChange(Model):
    """What may change about a job."""

    priority: Annotated[int, Field(ge=-100, le=100), NotBoolean]
    """Higher ones go first."""


OVERRIDES: Final = ("film", "sampler", "integrator", "adaptive", "stop")
"""The sections of a scene that a job may replace."""


class JobState(StrEnum):
    """A job's life."""

    QUEUED = "queued"
    COMPILING = "compiling"
    RENDERING = "rendering"
    PAUSED = "paused"
    FINISHING = "finishing"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """Nothing will happen to the job any more."""
        return self in (JobState.DONE, JobState.FAILED, JobState.CANCELLED)


class StopReason(StrEnum):
    """Why a render ended."""

    SAMPLES = "samples"
    SECONDS = "seconds"
    RELATIVE_ERROR = "relative_error"
    CANCELLED = "cancelled"
    FAILED = "failed"
    QUOTA = "quota"
    """Its key has no device-seconds left: the job is paused, and goes on once the quota is raised and it is resumed."""


class Interval(Model):
    """An interval that holds the true value with the stated confidence."""

    low: Measured
    high: Measured | None
    """Null: no upper bound is known."""
    confidence: Unit = 0.95


class JobLinks(Model):
    """Paths on the same host. What is not there yet answers 404. A job of several frames has pictures and receipts
    with each frame; its own thumbnail and noise map are those of the newest."""

    self: str
    exr: str
    thumbnail: str
    heatmap: str
    receipt: str
    events: str
    page: str
    frames: str | None = None
    """The frames of a job that has several, as have the next two."""
    contact_sheet: str | None = None
    movie: str | None = None


class Shortfall(Model):
    """A job's caps will end it before its error target does, as far as can be told."""

    target: Measured
    """Relative error that was asked for."""
    needed_samples: Measured
    """A pixel, to reach it."""
    needed_seconds: Measured
    """Of tracing, to reach it."""
    cap: Literal["samples", "seconds"]
    """Which one ends the job first."""
    expected_error: Measured
    """Relative error that it will end with."""
    message: str
    """The same in words."""


class Progress(Model):
    """How far a job is and how good its picture is."""

    progress: Unit = 0.0
    """Share of the work that is done, towards whichever stop rule is nearest."""
    samples_done: Measured = 0.0
    """Samples a pixel, on average."""
    samples_planned: Count | None = None
    """Samples a pixel at which the job stops; null: it stops by time or error."""
    seconds: Measured = 0.0
    """Of tracing."""
    device_seconds: Measured = 0.0
    """Of tracing, all devices together: what quotas count."""
    relmse: Measured | None = None
    """Pooled variance over pooled squared mean; null while it is unknown."""
    relative_error: Measured | None = None
    """sqrt(relmse)."""
    relative_error_interval: Interval | None = None
    theta: Float | None = None
    """Variance falls as samples^-theta; null while there are too few samples to tell."""
    predicted_seconds: Measured | None = None
    """Of tracing, still to go until the job stops; null where it cannot be told."""
    predicted_seconds_interval: Interval | None = None
    """No upper end: few pixels carry the error, and what a lower one takes may be many times as much. Null where a cap alone
    ends the job: how its seconds will vary is not known."""
    shortfall: Shortfall | None = None
    """The error target that the job cannot reach within its caps; null where it may."""
    thumbnail_revision: Count = 0
    """Rises with every new picture; 0: there is none yet."""


class ErrorPoint(Model):
    """The error when so much had been spent."""

    samples: Measured
    """A pixel, on average."""
    seconds: Measured
    """Of tracing."""
    relmse: Measured | None
    relative_error: Measured | None
    relative_error_interval: Interval | None = None


class FrameCounts(Model):
    """How far the frames of a job are."""

    total: Count
    done: Count = 0
    failed: Count = 0


class FrameLinks(Model):
    """Paths on the same host. What is not there yet answers 404."""

    self: str
    exr: str
    thumbnail: str
    heatmap: str
    receipt: str


class FrameStatus(Progress):
    """A frame as it stands."""

    number: Count
    time: Measured
    """Seconds: when the scene is looked at."""
    state: JobState
    stop_reason: StopReason | None = None
    problem: Problem | None = None
    """Why the frame failed."""
    started: datetime | None = None
    finished: datetime | None = None
    links: FrameLinks


class FramePage(Model):
    """A page of the frames of a job, by number."""

    items: tuple[FrameStatus, ...]
    next: Count | None = None
    """Pass it as `after` to get the next page; null at the end."""


class JobStatus(Progress):
    """A job as it stands. Where it has several frames, numbers are averages over them, seconds their sum, and the
    error is that of the newest finished one."""

    id: JobId
    name: str
    state: JobState
    priority: Integer = 0
    created: datetime
    started: datetime | None = None
    finished: datetime | None = None
    width: Count
    """Of the full frame, in pixels."""
    height: Count
    sampler: str
    stop: Stop
    stop_reason: StopReason | None = None
    """Set once the job has ended, or was paused for its key's quota."""
    problem: Problem | None = None
    """Why the job failed."""
    devices: tuple[str, ...] = ()
    """Ids of the devices that work, or worked, on it."""
    frames: FrameCounts | None = None
    """Null: the job makes a single picture."""
    links: JobLinks
    curve: tuple[ErrorPoint, ...] = ()
    """The error as it fell so far; left out of lists. Once the job is done, the receipt has all of it."""


class JobPage(Model):
    """A page of the list of jobs, newest first."""

    items: tuple[JobStatus, ...]
    next: str | None = None
    """Pass it as `cursor` to get the next page; null at the end."""


class ProgressEvent(Progress):
    """A server-sent event of the type 'progress': a job has moved."""

    id: JobId
    state: JobState
    stop_reason: StopReason | None = None
    problem: Problem | None = None
    frames: FrameCounts | None = None
    """Null: the job makes a single picture."""


class DeviceState(StrEnum):
    """A device's life."""

    STARTING = "starting"
    IDLE = "idle"
    BUSY = "busy"
    LOST = "lost"
    """Its process ended and could not be started again."""


class DeviceStatus(Model):
    """An OpenCL device and the process that drives it."""

    id: str
    name: str
    platform: str
    vendor: str = ""
    version: str = ""
    driver: str = ""
    kind: str = ""
    """cpu, gpu or accelerator."""
    compute_units: Count = 0
    memory_bytes: Count = 0
    bit_class: str | None = None
    """Devices of one class give the same bits for the same kernel."""
    state: DeviceState
    job: JobId | None = None
    leases_done: Count = 0
    crashes: Count = 0
    samples_per_second: Measured | None = None
    """Pixel samples, over the last leases."""


class DevicePage(Model):
    """All devices."""

    items: tuple[DeviceStatus, ...]


class AssetInfo(Model):
    """An asset in the store."""

    asset: str
    """sha256:..., which is what a scene names it by."""
    bytes: Count
    kind: str
    """image or mesh."""
    format: str
    """obj, ply, glb, exr, png ..."""
    detail: str = ""
    """Such as '120000 triangles' or '2048 x 1024 pixels'."""
    created: bool = True
    """False: the store had it already."""


class Health(Model):
    """Whether the service is well."""

    status: Annotated[str, StringConstraints(pattern=r"^(ok|degraded)$")]
    """degraded: it answers, but something is missing; `detail` says what."""
    version: str
    uptime_seconds: Measured
    jobs: dict[str, int] = Field(default_factory=dict)
    """How many there are in each state."""
    devices: dict[str, int] = Field(default_factory=dict)
    """How many there are in each state."""
    detail: tuple[str, ...] = ()


class Finding(Model):
    """Something worth knowing about a scene that is no error."""

    pointer: str
    message: str


class Validation(Model):
    """The answer to a valid scene that was only to be checked."""

    valid: bool = True
    scene_hash: str
    warnings: tuple[Finding, ...] = ()
