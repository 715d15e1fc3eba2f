"""`penumbra render` and `penumbra devices`: this machine's devices in processes of their own, no service."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from penumbra_kernels import cache
from penumbra_scene.exits import Exit
from penumbra_scene.job import (
    DevicePage,
    DeviceState,
    JobRequest,
    JobState,
    Progress,
    ProgressEvent,
)
from penumbra_scene.receipt import Receipt

from penumbra_service.commands import CommandError
from penumbra_service.engine.local import LocalEngine, NoDeviceError, list_devices
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.runner import Failure, JobRunner, RenderTask
from penumbra_service.engine.status import device_status
from penumbra_service.film.preview import PreviewImage
from penumbra_service.jobs.receipt import ReceiptContext
from penumbra_service.results import ALL, Latest, write_results

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
    request: JobRequest, folder: Path, out: Path, devices: str, report: Callable[[ProgressEvent], None]
) -> Receipt:
    """Render a job and leave its results in `out`; files that the scene names lie under `folder`.

    `devices` are ids with commas between them, or "" for all. Raises CommandError, OSError.
    """
    ids = [part.strip() for part in devices.split(",") if part.strip()]
    with (
        tempfile.TemporaryDirectory(prefix=".penumbra-", dir=out) as work,
        LocalEngine(ids or None) as engine,
    ):
        try:
            engine.wait_known()
        except NoDeviceError as error:
            raise CommandError(str(error), Exit.DEVICE) from error
        receipt = render_on(engine, request, folder, Path(work), report)
        for name in ALL:
            if (Path(work) / name).exists():
                shutil.move(Path(work) / name, out / name)
    return receipt


def render_on(
    engine: Engine,
    request: JobRequest,
    folder: Path,
    work: Path,
    report: Callable[[ProgressEvent], None] = lambda event: None,
) -> Receipt:
    """The same on an engine that runs already; results, snapshots and all lie in `work` afterwards."""
    scene = request.resolved_scene()
    started = datetime.now(UTC)
    latest = Latest()
    assets = cache.folder() / "assets"
    assets.mkdir(parents=True, exist_ok=True)
    task = RenderTask(
        JOB,
        scene,
        work,
        assets_folder=assets,
        scene_folder=folder,
        time=request.time,
        strict=request.strict,
    )

    def tell(state: JobState, progress: Progress) -> None:
        report(ProgressEvent(id=JOB, state=state, **progress.model_dump()))

    def keep(image: PreviewImage) -> None:
        latest.image = image

    result = JobRunner(engine, task, on_progress=tell, on_preview=keep).run()
    _raise_failure(result.failure)
    context = ReceiptContext(
        job=JOB,
        name=request.name or scene.name,
        created=started,
        started=started,
        finished=datetime.now(UTC),
        queue_seconds=0.0,
        time=request.time,
    )
    return write_results(work, scene, result, latest.image, context)


def _raise_failure(failure: Failure | None) -> None:
    if failure is not None:
        raise CommandError(failure.message, EXITS.get(failure.kind, Exit.FAILED))
