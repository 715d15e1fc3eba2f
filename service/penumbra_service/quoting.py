"""Quotes on an engine: of a service, or of this machine alone."""

from __future__ import annotations

from pathlib import Path

from penumbra_scene.errors import ProblemError
from penumbra_scene.job import JobRequest
from penumbra_scene.quote import Quote

from penumbra_service.engine.pilot import PilotRunner, PilotTask
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.task import Failure, RunFailedError
from penumbra_service.images.limits import DEFAULTS, DecodeLimits
from penumbra_service.jobs.quote import build_quote
from penumbra_service.picture import problem_of


def make_quote(
    engine: Engine,
    request: JobRequest,
    folder: Path,
    assets: Path,
    *,
    scene_folder: Path | None = None,
    decode: DecodeLimits = DEFAULTS,
) -> Quote:
    """Renders a pilot; its files go into `folder`, which the caller removes. Of a range of frames, the first is quoted.

    Raises ProblemError, as a job that fails would show it.
    """
    scene = request.resolved_scene()
    task = PilotTask(scene, folder, assets, scene_folder, request.time, decode)
    said = ("the quote is for one frame: the first of the range",) if request.sequence else ()
    try:
        return build_quote(scene, request.time, PilotRunner(engine, task).run(), said)
    except RunFailedError as failed:
        raise ProblemError(problem_of(failed.failure)) from failed
    except OSError as error:
        raise ProblemError(problem_of(Failure("storage", str(error)))) from error
