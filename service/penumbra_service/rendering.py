"""`penumbra render`, `penumbra quote` and `penumbra devices`: this machine's devices in processes of their own, no service."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from penumbra_kernels import cache
from penumbra_scene.errors import TYPE_PREFIX, Problem, ProblemError
from penumbra_scene.exits import Exit
from penumbra_scene.job import (
    DevicePage,
    DeviceState,
    JobRequest,
    JobState,
    ProgressEvent,
)
from penumbra_scene.quote import Quote
from penumbra_scene.receipt import Receipt
from penumbra_scene.scene import Scene

from penumbra_service.commands import CommandError
from penumbra_service.engine.launch import Child, ids_of
from penumbra_service.engine.local import LocalEngine, NoDeviceError, list_devices
from penumbra_service.engine.protocol import ServedEngine
from penumbra_service.engine.status import device_status
from penumbra_service.engine.task import FixedPlan
from penumbra_service.film.replicates import Layout
from penumbra_service.frames import run_frames
from penumbra_service.out_folder import OutBook, finished_frames, move_files, work_folder
from penumbra_service.picture import Picture, PictureRunner
from penumbra_service.quoting import make_quote
from penumbra_service.results import ALL, OF_SEQUENCE
from penumbra_service.running import Control, Outcome
from penumbra_service.sequence import frames_at_once

JOB: Final = "local"
"""What a render without a service is called where a job's id stands."""
EXITS: Final = {
    "scene": Exit.INVALID,
    "build": Exit.DEVICE,
    "device": Exit.DEVICE,
    "crash": Exit.DEVICE,
    "storage": Exit.USAGE,
}
"""Exit status for each kind of engine.runner.Failure."""


def local_devices() -> DevicePage:
    """The OpenCL devices of this machine; none is no error.

    Raises CommandError where they cannot be listed.
    """
    try:
        found = list_devices()
    except NoDeviceError as error:
        raise CommandError(str(error), Exit.DEVICE) from error
    return DevicePage(items=tuple(device_status(device, DeviceState.IDLE) for device in found))


def render(
    request: JobRequest,
    folder: Path,
    out: Path,
    devices: str,
    report: Callable[[ProgressEvent], None],
    first: Child | None = None,
    *,
    anew: bool = False,
) -> tuple[Receipt, ...]:
    """Render a job and leave its results in `out`; files that the scene names lie under `folder`. The receipts of its
    pictures: one, or those of its frames, whose files lie in folders of their own. Frames of the same render that are in `out`
    already are kept, unless `anew`.

    `devices` are ids with commas between them, or "" for all; `first` is their first process, if it was started ahead.
    Raises CommandError, OSError.
    """
    with (
        work_folder(out) as work,
        local_engine(devices, first=first) as engine,
    ):
        if not request.sequence:
            receipt = render_on(engine, request, folder, work, report)
            move_files(work, out, ALL)
            return (receipt,)
        book = OutBook(work, out, {} if anew else finished_frames(request, folder, out))
        whole = _picture(request, work, report)
        try:
            outcome = run_frames(
                _pictures(engine, folder), request, whole, book, frames_at_once(len(engine.usable()))
            )
        finally:
            move_files(work, out, OF_SEQUENCE)
        _raise_problem(outcome)
        return tuple(book.receipts[frame] for frame in sorted(book.receipts))


def render_on(
    engine: ServedEngine,
    request: JobRequest,
    folder: Path,
    work: Path,
    report: Callable[[ProgressEvent], None] = lambda event: None,
) -> Receipt:
    """A single picture on an engine that runs already; results, snapshots and all lie in `work` afterwards."""
    outcome = _pictures(engine, folder).run(_picture(request, work, report))
    _raise_problem(outcome)
    assert outcome.receipt is not None
    return outcome.receipt


def render_plan(
    scene: Scene, layout: Layout, fixed: FixedPlan, time: float, folder: Path, out: Path, devices: str
) -> Receipt:
    """Render exactly the samples of a plan, in as many replicates and strata as `layout` has.

    Raises CommandError, OSError.
    """
    with (
        work_folder(out) as work,
        local_engine(devices) as engine,
    ):
        picture = replace(
            _picture(JobRequest(scene=scene), work, lambda event: None),
            layout=layout,
            fixed=fixed,
            time=time,
        )
        outcome = _pictures(engine, folder).run(picture)
        _raise_problem(outcome)
        assert outcome.receipt is not None
        move_files(work, out, ALL)
        return outcome.receipt


def quote(request: JobRequest, folder: Path, devices: str) -> Quote:
    """What a job would cost on this machine; arguments as for `render`. Raises CommandError."""
    with tempfile.TemporaryDirectory(prefix="penumbra-") as work, local_engine(devices) as engine:
        try:
            return make_quote(engine, request, Path(work), assets_folder(), scene_folder=folder)
        except ProblemError as error:
            raise _command_error(error.problem) from error


@contextmanager
def local_engine(devices: str, first: Child | None = None) -> Iterator[LocalEngine]:
    """An engine of this machine that knows its devices; ids with commas between them, or "" for all.

    Raises CommandError, CacheError.
    """
    with LocalEngine(ids_of(devices), first=first) as engine:
        cache.check()
        try:
            engine.wait_known()
        except NoDeviceError as error:
            raise CommandError(str(error), Exit.DEVICE) from error
        yield engine


def assets_folder() -> Path:
    """Where decoded assets are kept where there is no service. Raises CacheError."""
    return cache.made("assets")


def _pictures(engine: ServedEngine, folder: Path) -> PictureRunner:
    return PictureRunner(engine, assets_folder(), scene_folder=folder)


def _picture(request: JobRequest, work: Path, report: Callable[[ProgressEvent], None]) -> Picture:
    scene = request.resolved_scene()

    def tell(state: JobState, news: Mapping[str, Any]) -> None:
        live = {name: value for name, value in news.items() if name in ProgressEvent.model_fields}
        report(ProgressEvent.model_validate({**live, "id": JOB, "state": state}))

    return Picture(
        JOB,
        request.name or scene.name,
        scene,
        work,
        Control(),
        report=tell,
        show=None,
        time=request.time,
        strict=request.strict,
        measure_effects=request.measure_effects,
    )


def _raise_problem(outcome: Outcome) -> None:
    if outcome.problem is not None:
        raise _command_error(outcome.problem)


def _command_error(problem: Problem) -> CommandError:
    kind = problem.type.removeprefix(f"{TYPE_PREFIX}job-")
    return CommandError(problem.detail, EXITS.get(kind, Exit.FAILED))
