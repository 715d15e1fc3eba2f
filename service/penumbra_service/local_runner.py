"""Runs jobs on the devices of an engine: this machine's, or a farm's."""

from __future__ import annotations

import logging
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final

from penumbra_scene.errors import Problem, make_problem
from penumbra_scene.job import DeviceStatus, ErrorPoint, JobState, Progress
from penumbra_scene.scene import Scene

from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.protocol import ServedEngine
from penumbra_service.engine.runner import Failure, Halt, JobRunner, RenderTask, RunResult
from penumbra_service.film.preview import PreviewImage
from penumbra_service.jobs.receipt import ReceiptContext
from penumbra_service.results import Latest, write_pictures, write_results
from penumbra_service.running import Halt as Ask
from penumbra_service.running import Outcome, Task
from penumbra_service.service import decode_limits
from penumbra_service.settings import Settings, SettingsError
from penumbra_service.store.contents import contents_url

log = logging.getLogger(__name__)

FAILURES: Final[dict[str, tuple[int, str]]] = {
    "scene": (422, "The scene cannot be rendered"),
    "build": (500, "The kernel does not build on any device"),
    "crash": (500, "The job crashed the device too often"),
    "device": (503, "There is no device to render on"),
    "storage": (500, "The job's files cannot be read or written"),
}
"""HTTP status and title for each kind of engine.runner.Failure."""


def engine_of(settings: Settings) -> ServedEngine:
    """This machine's devices, or those of the farm whose scheduler the settings name. Raises SettingsError."""
    if not settings.scheduler:
        ids = [part.strip() for part in settings.devices.split(",") if part.strip()]
        return LocalEngine(ids or None)
    try:
        from penumbra_service.engine.dask.engine import DaskEngine
    except ImportError as error:
        raise SettingsError(
            f"scheduler: given {settings.scheduler!r}, which needs the extra 'farm' ({error}): "
            "pip install 'penumbra-render[service,farm]'"
        ) from error
    return DaskEngine(settings.scheduler, contents_url(settings.artifacts), settings.tls_folder)


class LocalRunner:
    """Implements running.Runner."""

    def __init__(self, settings: Settings) -> None:
        self._assets = settings.assets_folder
        self._decode = decode_limits(settings)
        self._verify = settings.verify_share
        self._engine = engine_of(settings)

    def start(self) -> None:
        """Returns at once; devices come up by themselves."""
        self._engine.start()

    def stop(self) -> None:
        """Ends the devices' processes."""
        self._engine.stop()

    def devices(self) -> list[DeviceStatus]:
        """Every device as it stands."""
        return self._engine.devices()

    @property
    def problem(self) -> str | None:
        """Why nothing can be rendered, if so."""
        return self._engine.problem

    def run(self, task: Task) -> Outcome:
        """See running.Runner."""
        scene = task.request.resolved_scene()
        latest = Latest()
        runner = JobRunner(
            self._engine,
            RenderTask(
                task.job_id,
                scene,
                task.folder,
                assets_folder=self._assets,
                time=task.request.time,
                priority=task.priority,
                decode=self._decode,
                strict=task.request.strict,
                verify=self._verify,
            ),
            on_progress=self._reporter(task),
            on_preview=_shower(task, scene, latest),
        )
        task.control.when_halted(lambda ask: runner.halt(Halt.CANCEL if ask is Ask.CANCEL else Halt.PAUSE))
        result = runner.run()
        return self._ended(task, scene, result, latest)

    def _reporter(self, task: Task) -> Callable[[JobState, Progress], None]:
        used: set[str] = set()
        curve: list[dict[str, Any]] = []
        kept: list[float] = []  # samples that the snapshot brought

        def report(state: JobState, progress: Progress) -> None:
            if not kept:
                kept.append(progress.samples_done)
            if state is JobState.COMPILING and progress.samples_done > kept[0]:
                state = (
                    JobState.RENDERING
                )  # a device that has the scene loaded from before does not say so again
            used.update(device.id for device in self._engine.devices() if device.job == task.job_id)
            news: dict[str, Any] = progress.model_dump(mode="json", exclude={"thumbnail_revision"})
            if progress.relmse is not None and (not curve or curve[-1]["relmse"] != progress.relmse):
                curve.append(_error_point(progress))
            task.report(state, {**news, "devices": sorted(used), "curve": list(curve)})

        return report

    def _ended(self, task: Task, scene: Scene, result: RunResult, latest: Latest) -> Outcome:
        if result.failure is not None:
            return Outcome(problem=problem_of(result.failure))
        if result.state is not JobState.FINISHING:
            return Outcome()
        context = ReceiptContext(
            job=task.job_id,
            name=task.request.name or scene.name,
            created=task.created,
            started=task.started,
            finished=datetime.now(UTC),
            queue_seconds=(task.started - task.created).total_seconds(),
            time=task.request.time,
        )
        try:
            write_results(task.folder, scene, result, latest.image, context)
        except OSError as error:
            log.exception("job %s: its results cannot be written", task.job_id)
            return Outcome(problem=problem_of(Failure("storage", f"its results cannot be written: {error}")))
        return Outcome(result.reason)


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


def _shower(task: Task, scene: Scene, latest: Latest) -> Callable[[PreviewImage], None]:
    """Keeps the newest preview, and puts it where the thumbnail is looked for."""

    def show(image: PreviewImage) -> None:
        latest.image = image
        try:
            write_pictures(task.folder, scene, image)
        except OSError:
            log.warning("job %s: no preview can be written", task.job_id, exc_info=True)
            return
        task.show()

    return show
