"""Renders one picture, of a job or of one of its frames, on an engine, and leaves its files in a folder."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from penumbra_scene.errors import Problem, make_problem
from penumbra_scene.job import ErrorPoint, JobState, Progress, StopReason
from penumbra_scene.measured import EffectsMeasured
from penumbra_scene.receipt import Receipt
from penumbra_scene.scene import Scene

from penumbra_service.engine.protocol import ServedEngine
from penumbra_service.engine.runner import (
    SPACE_SECONDS,
    TICK_SECONDS,
    Failure,
    Halt,
    JobRunner,
    RenderTask,
    RunResult,
)
from penumbra_service.engine.standing import Standing
from penumbra_service.engine.task import VERIFY_SHARE, FixedPlan
from penumbra_service.film.film import MEMORY_LIMIT
from penumbra_service.film.preview import PreviewImage
from penumbra_service.film.replicates import Layout
from penumbra_service.images.limits import DEFAULTS, DecodeLimits
from penumbra_service.jobs.receipt import ReceiptContext
from penumbra_service.measuring import for_receipt
from penumbra_service.results import Latest, write_pictures, write_results
from penumbra_service.running import Control, Outcome
from penumbra_service.running import Halt as Ask
from penumbra_service.store.room import is_full

log = logging.getLogger(__name__)

FAILURES: Final[dict[str, tuple[int, str]]] = {
    "scene": (422, "The scene cannot be rendered"),
    "build": (500, "The kernel does not build on any device"),
    "crash": (500, "The job crashed the device too often"),
    "device": (503, "There is no device to render on"),
    "storage": (500, "The job's files cannot be read or written"),
}
"""HTTP status and title for each kind of engine.runner.Failure."""


@dataclass(frozen=True)
class Picture:
    """What is to be rendered, and whom to tell."""

    job: str
    name: str
    scene: Scene
    folder: Path
    """A snapshot in it is continued; results are left in it under the names of `results`."""
    control: Control
    report: Callable[[JobState, Mapping[str, Any]], None]
    show: Callable[[], None] | None
    """Called when there are a new thumbnail and noise map in the folder; None where nobody looks before the end."""
    time: float = 0.0
    """Seconds: when the scene is looked at."""
    frame: int | None = None
    priority: int = 0
    created: datetime = field(default_factory=lambda: datetime.now(UTC))
    started: datetime = field(default_factory=lambda: datetime.now(UTC))
    memory_limit: int = MEMORY_LIMIT
    strict: bool = False
    """Only devices of one bit class."""
    measure_effects: bool = False
    """Say in the receipt what each effect cost."""
    layout: Layout | None = None
    """Of replicates and samples; None: as sampler and stop rule have it."""
    standing: Standing = field(default_factory=Standing)
    """Of devices with the job: one for all of its frames."""
    fixed: FixedPlan | None = None
    """Samples that are known beforehand."""


class PictureRunner:
    """Renders pictures on an engine; several at once, in as many threads."""

    def __init__(
        self,
        engine: ServedEngine,
        assets_folder: Path,
        scene_folder: Path | None = None,
        decode: DecodeLimits = DEFAULTS,
        verify: float = VERIFY_SHARE,
        *,
        patient: bool = False,
    ) -> None:
        """`patient`: a full disk is waited for."""
        self._engine = engine
        self._assets = assets_folder
        self._scene_folder = scene_folder
        self._decode = decode
        self._verify = verify
        self._patient = patient

    def run(self, picture: Picture) -> Outcome:
        """Blocks until the picture is there or cannot be had, or `picture.control` asked for a stop."""
        latest = Latest()
        runner = JobRunner(
            self._engine,
            RenderTask(
                picture.job,
                picture.scene,
                picture.folder,
                assets_folder=self._assets,
                scene_folder=self._scene_folder,
                time=picture.time,
                frame=picture.frame,
                priority=picture.priority,
                memory_limit=picture.memory_limit,
                decode=self._decode,
                strict=picture.strict,
                layout=picture.layout,
                standing=picture.standing,
                fixed=picture.fixed,
                verify=self._verify,
                wait_for_room=self._patient,
            ),
            on_progress=self._reporter(picture),
            on_preview=_shower(picture, latest),
        )
        picture.control.when_halted(lambda ask: runner.halt(Halt.CANCEL if ask is Ask.CANCEL else Halt.PAUSE))
        picture.control.when_prioritized(runner.prioritize)
        return self._ended(picture, runner.run(), latest)

    def _ended(self, picture: Picture, result: RunResult, latest: Latest) -> Outcome:
        if result.failure is not None:
            return Outcome(problem=problem_of(result.failure))
        if result.state is not JobState.FINISHING:
            return Outcome()
        measured, warnings = self._measure(picture, result)
        context = ReceiptContext(
            job=picture.job,
            name=picture.name,
            created=picture.created,
            started=picture.started,
            finished=datetime.now(UTC),
            queue_seconds=(picture.started - picture.created).total_seconds(),
            time=picture.time,
            frame=picture.frame,
            effects_measured=measured,
            warnings=warnings,
        )
        return self._write(
            picture,
            lambda: write_results(picture.folder, picture.scene, result, latest, context),
            result.reason,
        )

    def _write(self, picture: Picture, write: Callable[[], Receipt], reason: StopReason | None) -> Outcome:
        """The results, as soon as there is room for them where a full disk is waited for."""
        while True:
            try:
                return Outcome(reason, receipt=write())
            except OSError as error:
                if not (self._patient and is_full(error)):
                    log.exception("job %s: its results cannot be written", picture.job)
                    told = f"its results cannot be written: {error}"
                    return Outcome(problem=problem_of(Failure("storage", told)))
                log.warning("job %s: %s; its results are written when there is room", picture.job, error)
            end = time.monotonic() + SPACE_SECONDS
            while time.monotonic() < end:
                if picture.control.reason is not None:
                    return Outcome()
                time.sleep(TICK_SECONDS)

    def _measure(self, picture: Picture, result: RunResult) -> tuple[EffectsMeasured | None, tuple[str, ...]]:
        if not picture.measure_effects:
            return None, ()
        record = result.record
        devices = [use.id for use in record.devices.values()]
        rays = record.adaptive.shadow_rays if record.adaptive else 0
        return for_receipt(picture.folder, picture.time, devices, self._assets, self._scene_folder, rays)

    def _reporter(self, picture: Picture) -> Callable[[JobState, Progress], None]:
        used: set[str] = set()
        curve: list[dict[str, Any]] = []
        kept: list[float] = []  # samples that the snapshot brought

        def report(state: JobState, progress: Progress) -> None:
            if not kept:
                kept.append(progress.samples_done)
            if state is JobState.COMPILING and progress.samples_done > kept[0]:
                # a device that has the scene loaded from before does not say so again
                state = JobState.RENDERING
            used.update(device.id for device in self._engine.devices() if device.job == picture.job)
            news: dict[str, Any] = progress.model_dump(mode="json", exclude={"thumbnail_revision"})
            if progress.relmse is not None and (not curve or curve[-1]["relmse"] != progress.relmse):
                curve.append(_error_point(progress))
            picture.report(state, {**news, "devices": sorted(used), "curve": list(curve)})

        return report


def _error_point(progress: Progress) -> dict[str, Any]:
    point = ErrorPoint(
        samples=progress.samples_done,
        seconds=progress.seconds,
        relmse=progress.relmse,
        relative_error=progress.relative_error,
        relative_error_interval=progress.relative_error_interval,
    )
    return point.model_dump(mode="json")


def problem_of(failure: Failure) -> Problem:
    """What a failed job shows."""
    status, title = FAILURES.get(failure.kind, (500, "The job failed"))
    return make_problem(f"job-{failure.kind}", title, status, failure.message)


def _shower(picture: Picture, latest: Latest) -> Callable[[PreviewImage], None]:
    """Keeps the newest preview, and puts it where the thumbnail is looked for."""

    def show(image: PreviewImage) -> None:
        latest.image, latest.written = image, False
        if picture.show is None:
            return
        try:
            write_pictures(picture.folder, picture.scene, image)
        except OSError:
            log.warning("job %s: no preview can be written", picture.job, exc_info=True)
            return
        latest.written = True
        picture.show()

    return show
