"""The receipt: what a render was, what it cost, how wrong it is, and what must be known to make it again."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from penumbra_scene.base import Bool, Float, Integer, Measured, Model, NotBoolean, Unit
from penumbra_scene.film import Crop, Filter
from penumbra_scene.job import Count, ErrorPoint, Interval, JobId, StopReason
from penumbra_scene.limits import MAX_RESOLUTION
from penumbra_scene.measured import EffectsMeasured
from penumbra_scene.settings import Stop


class StageTime(Model):
    """Seconds of one stage of a job."""

    seconds: Measured
    warm: Bool | None = None
    """True: a cache or a running process answered; false: from scratch; null: there is no such choice."""


class Stages(Model):
    """Seconds by stage. Devices trace at the same time: `trace` adds up device seconds."""

    queue: StageTime
    compile: StageTime
    """Building the OpenCL program."""
    build: StageTime
    """Decoding assets, making arrays and trees, uploading them."""
    trace: StageTime
    write: StageTime
    """EXR, thumbnail, heat map."""
    wall_seconds: Measured
    """From submission to the last file."""


class ReceiptFilm(Model):
    """What was rendered."""

    width: Count
    height: Count
    crop: Crop | None = None
    filter: Filter
    layers: tuple[str, ...] = ()
    half: Bool = False


class ReceiptError(Model):
    """How wrong the picture is, as estimated from itself."""

    relmse: Measured | None = None
    """Null: the sampler gives no variance."""
    relative_error: Measured | None = None
    relative_error_interval: Interval | None = None
    mse: Measured | None = None
    """Mean over pixels and channels of the variance of the pixel's mean, (W / (m^2 sr))^2."""
    theta: Float | None = None
    """Fitted exponent: variance falls as samples^-theta."""
    theta_interval: tuple[Float, Float] | None = None
    method: str
    """How variance was made, in words."""
    curve: tuple[ErrorPoint, ...] = ()
    """The error as it fell."""


class Forecast(Model):
    """What was predicted, and when, beside what was needed. Null: nothing was predicted."""

    at_samples: Measured | None = None
    """Samples a pixel at which the prediction was made."""
    predicted_samples: Measured | None = None
    predicted_seconds: Measured | None = None
    real_samples: Measured
    real_seconds: Measured


class Counts(Model):
    """Samples and pixels by what became of them."""

    taken: Count
    """Samples that count, all pixels and replicates together."""
    lit: Count
    """Of these, samples that carried light."""
    rejected: Count
    """Samples that were NaN, infinite or negative, and were left out."""
    rejected_in: dict[str, int] = Field(default_factory=dict)
    """By effect."""
    rays: Count = 0
    """Traced by all samples, shadow rays included."""
    rays_per_path: Measured | None = None
    """Null: no path was traced."""
    pixels: Count
    flagged_pixels: Count = 0
    """Pixels whose error bar is not to be trusted: heavy tails, or too few samples that carried light."""
    flagged_share: Unit = 0.0
    empty_pixels: Count = 0
    """Pixels without any sample (sampler `random`)."""


class EffectReport(Model):
    """An effect, and why the scene calls for it or does not. A generic program has the others too (`programs`)."""

    name: str
    reason: str
    pointer: str | None = None
    """JSON pointer to the place in the scene that calls for it."""


class ReceiptDevice(Model):
    """A device that worked on the job."""

    id: str
    name: str
    platform: str
    driver: str
    bit_class: str
    leases: Count = 0
    seconds: Measured = 0.0
    failures: Count = 0
    """Crashes, hangs and refusals under this job."""
    blocked: Literal["build", "failures", "wrong"] | None = None
    """Why it got no more of the job: its compiler refused, it failed three times, or it gave wrong sums."""


class ReceiptProgram(Model):
    """What one program rendered on one device. A scene's own program and the generic one give the same bits, so that one may
    take over from the other between two leases."""

    device: str
    """Its id."""
    program: Literal["specialised", "generic"]
    """With just the scene's effects, or with all."""
    hash: str
    """SHA-256 of its text."""
    background_seconds: Measured = 0.0
    """Of building it while another one rendered; no part of the stages' seconds."""
    leases: Count = 0
    samples: Count = 0
    """All pixels and replicates together, with those that were rendered ahead and dropped."""
    first_sample: Count = 0
    end: Count = 0
    """Every sample that it took has an index, in its replicate, from `first_sample` up to before `end`."""


class LevelShare(Model):
    """Pixels that took equally many samples."""

    samples: Count
    """A pixel, all replicates together."""
    share: Unit
    """Of the picture's pixels."""


class SampleMap(Model):
    """Which of the plan's sample indices each pixel has taken. A pixel of level j takes the indices below `kept`, and of
    those from there on the multiples of 2^j; level 255 takes nothing from `kept` on."""

    block: Annotated[Literal[1, 2, 4], NotBoolean]
    """Side in pixels of the blocks that share a level; they are aligned to the full frame."""
    rows: Annotated[int, Field(ge=1, le=MAX_RESOLUTION), NotBoolean]
    columns: Annotated[int, Field(ge=1, le=MAX_RESOLUTION), NotBoolean]
    kept: Count = 0
    """Indices of each replicate that every pixel takes."""
    kept_planned: Count = 0
    """Indices of each replicate that their strata were made for; 0: strata doubled as they filled."""
    shadow_rays: Count = 0
    """In place of the scene's; 0: those themselves."""
    kept_shadow_rays: tuple[Count, Count] = (0, 0)
    """Likewise at the indices below `kept`, in the first half of the replicates and in the second."""
    levels: str
    """A byte for each block, row by row: compressed by zlib, in base64."""


class AdaptiveReport(Model):
    """How the samples were spread over the picture."""

    strategy: Literal["error", "contrast"]
    mode: Literal["certified", "fast"]
    biased: Bool
    """Whether the samples that decided stayed in the picture."""
    pilot_samples: Count
    """A pixel."""
    pilot_seconds: Measured
    """Of tracing; part of the job's seconds."""
    theta: Float | None = None
    """The exponent that the samples were shared out by; null for `contrast`."""
    shadow_rays: Integer | None = None
    """How many of the scene's `shadow_rays` paid, and were taken; null where the pilot did not decide it: hits took all."""
    levels: tuple[LevelShare, ...]
    """Most samples first."""
    map: SampleMap | None = None
    """Null in receipts of versions that did not record it."""


class PlanStep(Model):
    """A range of sample indices that every replicate of every pixel (or of one tile) has taken; of an adaptive render,
    each pixel its share of them."""

    first_sample: Count
    sample_count: Count
    tile: Crop | None = None
    """Null: the whole window."""


class Receipt(Model):
    """A finished render."""

    schema_version: Annotated[Literal[1], NotBoolean] = 1
    job: JobId
    name: str
    created: datetime
    started: datetime | None = None
    finished: datetime
    versions: dict[str, str]
    """Of this package and of what it stands on."""
    scene_hash: str
    """sha256:..., of the scene as rendered in canonical JSON."""
    picture_hash: str | None = None
    """sha256:..., of what decides the picture that a render converges to: renders that differ in sampler, seed or
    stop rule have the same, and `penumbra merge` takes them together."""
    program_hash: str | None = None
    """SHA-256 of the text of the program that rendered last."""
    kernel_hash: str | None = None
    """Of the kernels package's sources."""
    time: Float = 0.0
    """Seconds: when the scene was looked at."""
    frame: Count | None = None
    """Its number, where the job has several."""
    film: ReceiptFilm
    sampler: str
    seed: Annotated[str, Field(pattern=r"^[0-9]{1,20}$")]
    """As a string: JSON numbers lose bits beyond 2^53."""
    replicates: Integer
    samples: Measured
    """A pixel, on average, all replicates together. Of an adaptive render `stop.samples` to a fraction of one; by contrast, to
    the nearest step that all levels allow."""
    stop: Stop
    """The rule that was asked for."""
    stop_reason: StopReason
    stages: Stages
    error: ReceiptError
    forecast: Forecast
    counts: Counts
    adaptive: AdaptiveReport | None = None
    """Null: every pixel was asked for the same number of samples."""
    effects_in: tuple[EffectReport, ...] = ()
    effects_out: tuple[EffectReport, ...] = ()
    not_covered: tuple[EffectReport, ...] = ()
    """Light that this render leaves out, or finds by chance alone; neither the picture nor its error bars know of it."""
    effects_measured: EffectsMeasured | None = None
    """What each effect cost, where the job asked for it."""
    devices: tuple[ReceiptDevice, ...] = ()
    programs: tuple[ReceiptProgram, ...] = ()
    """Which program rendered what, in the order in which they began."""
    bit_class: str
    """On a device of this class the plan below gives the same bits again; 'mixed' if there were several."""
    plan: tuple[PlanStep, ...] = ()
    redone_leases: Count = 0
    """Work that had to be done again, after crashes and restarts."""
    resumed: Count = 0
    """Times that it went on from a snapshot, after a pause, a restart or a full disk: what was newer was done again."""
    checked_leases: Count = 0
    """Done by two devices, whose sums agreed or a third decided."""
    warnings: tuple[str, ...] = ()
