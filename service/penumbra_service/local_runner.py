"""Runs jobs on the devices of an engine: this machine's, or a farm's."""

from __future__ import annotations

from pathlib import Path

from penumbra_scene.job import DeviceStatus, JobRequest
from penumbra_scene.quote import Quote

from penumbra_service.engine.launch import Child, ids_of
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.protocol import ServedEngine
from penumbra_service.frames import run_frames
from penumbra_service.picture import Picture, PictureRunner
from penumbra_service.quoting import make_quote
from penumbra_service.running import Outcome, Task
from penumbra_service.sequence import frames_at_once
from penumbra_service.service import decode_limits
from penumbra_service.settings import Settings, SettingsError
from penumbra_service.store.contents import contents_url


def engine_of(settings: Settings, first: Child | None = None) -> ServedEngine:
    """This machine's devices (`first`: their first process, if it was started ahead), or those of the farm whose scheduler
    the settings name. Raises SettingsError."""
    if not settings.scheduler:
        return LocalEngine(ids_of(settings.devices), first=first)
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

    def __init__(self, settings: Settings, engine: ServedEngine | None = None) -> None:
        """`engine`: by default the one that the settings name. Raises SettingsError."""
        self._engine = engine or engine_of(settings)
        self._assets = settings.assets_folder
        self._decode = decode_limits(settings)
        self._pictures = PictureRunner(
            self._engine,
            self._assets,
            decode=self._decode,
            verify=settings.verify_share,
            patient=True,
        )

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
        request = task.request
        scene = request.resolved_scene()
        picture = Picture(
            task.job_id,
            request.name or scene.name,
            scene,
            task.folder,
            task.control,
            task.report,
            task.show,
            time=request.time,
            priority=task.priority,
            strict=request.strict,
            measure_effects=request.measure_effects,
            created=task.created,
            started=task.started,
        )
        if not request.sequence:
            return self._pictures.run(picture)
        at_once = frames_at_once(len(self._engine.usable()))
        return run_frames(self._pictures, request, picture, task.frames, at_once)

    def quote(self, request: JobRequest, folder: Path) -> Quote:
        """See running.Runner."""
        return make_quote(self._engine, request, folder, self._assets, decode=self._decode)
