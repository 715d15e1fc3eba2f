"""What a run is asked to do, and how it can end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final

from penumbra_scene.job import JobState, StopReason
from penumbra_scene.scene import Scene

from penumbra_service.engine.standing import Standing
from penumbra_service.film.develop import Developed, develop_bands
from penumbra_service.film.film import MEMORY_LIMIT, Film
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.replicates import Layout
from penumbra_service.images.limits import DEFAULTS, DecodeLimits
from penumbra_service.jobs.record import AdaptiveUse, RunRecord

VERIFY_SHARE: Final = 0.01
"""Of leases that are done twice, unless told otherwise."""


class Halt(StrEnum):
    """Why a run is asked to end early."""

    PAUSE = "pause"
    """Keep a snapshot: another run can go on."""
    CANCEL = "cancel"
    """Keep nothing."""


@dataclass(frozen=True)
class FixedPlan:
    """Samples that are known beforehand: those of a picture that is rendered again. The scene's stop rule ends nothing."""

    end: int
    """Indices of each replicate."""
    levels: LevelMap | None = None
    """Of an adaptive picture: how its pixels share in them."""
    adaptive: AdaptiveUse | None = None
    """What had decided that."""


@dataclass(frozen=True)
class RenderTask:
    """A job to run."""

    job: str
    scene: Scene
    """As it is to be rendered."""
    folder: Path
    """The job's own; a snapshot in it is continued."""
    assets_folder: Path | None = None
    """Assets by content."""
    scene_folder: Path | None = None
    """What `file` references are relative to; None: they are refused."""
    time: float = 0.0
    """Seconds: when the scene is looked at."""
    frame: int | None = None
    """Its number, where the job has several."""
    priority: int = 0
    program: str = "auto"
    """Or 'specialised', 'generic': that one from the first sample to the last."""
    memory_limit: int = MEMORY_LIMIT
    decode: DecodeLimits = DEFAULTS
    """On assets that have to be decoded anew."""
    layout: Layout | None = None
    """Of replicates and samples; None: as sampler and stop rule have it."""
    fixed: FixedPlan | None = None
    """None: the scene's stop rule ends the run, and a pilot decides what its `adaptive` asks for."""
    wait_for_room: bool = False
    """A full disk does not fail the job: it goes on from its last snapshot when there is room."""
    strict: bool = False
    """Only devices of one bit class: that of the first that works on it."""
    standing: Standing = field(default_factory=Standing)
    """Of devices with the job: one for all of its frames."""
    verify: float = VERIFY_SHARE
    """Share of leases that two devices do and whose sums are compared, beside each device's first; 0: none."""

    @property
    def name(self) -> str:
        """No other run has it at the same time."""
        return self.job if self.frame is None else f"{self.job}/{self.frame}"


@dataclass(frozen=True)
class Failure:
    """Why a run failed. kind: 'scene', 'build', 'crash', 'device', 'storage'."""

    kind: str
    message: str


class RunFailedError(Exception):
    """Ends a run."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.failure = Failure(kind, message)


@dataclass(frozen=True)
class RunResult:
    """How a run ended. state: FINISHING (the picture is there, to be written), PAUSED, CANCELLED or
    FAILED."""

    state: JobState
    record: RunRecord
    reason: StopReason | None = None
    failure: Failure | None = None
    film: Film | None = None
    end: int = 0
    """Samples a replicate that make the picture."""
    layers: tuple[str, ...] = ()
    levels: LevelMap | None = None
    """How pixels share in the samples."""

    def bands(self) -> Iterator[Developed]:
        """The picture's channels, as bands of scanlines from the top."""
        assert self.film is not None
        return develop_bands(self.film, self.end, self.layers)
