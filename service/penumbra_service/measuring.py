"""Having a process measure what each effect of a scene costs (engine/measure_process.py). Imports no driver."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from penumbra_kernels import pocl_cache
from penumbra_scene.measured import EffectsMeasured

log = logging.getLogger(__name__)

COMMAND: Final = (sys.executable, "-m", "penumbra_service.engine.measure_process")
TIMEOUT_SECONDS: Final = 900.0
RECEIPT_BUDGET: Final = 2.0
"""Seconds of tracing for a receipt's table."""


class MeasureError(RuntimeError):
    """Nothing could be measured; the message says why."""


@dataclass(frozen=True)
class Request:
    """What to measure."""

    scene: str
    """The scene's file."""
    assets_folder: str | None
    scene_folder: str | None
    time: float
    """Seconds: when the scene is looked at."""
    device: str | None
    """None: the first."""
    budget: float
    """Seconds of tracing, about."""
    shadow_rays: int = 0
    """That hits take; 0: the scene's."""


def measure_effects(request: Request) -> EffectsMeasured:
    """Have a process measure. Raises MeasureError."""
    try:
        done = subprocess.run(
            COMMAND,
            input=json.dumps(asdict(request)),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_SECONDS,
            check=False,
            env=pocl_cache.own_environment(),
        )
    except subprocess.TimeoutExpired as error:
        raise MeasureError(f"measuring took more than {TIMEOUT_SECONDS:g} s") from error
    if done.returncode != 0:
        raise MeasureError(done.stderr.strip()[-2000:] or f"measuring ended with code {done.returncode}")
    return EffectsMeasured.model_validate_json(done.stdout)


def for_receipt(
    folder: Path,
    time: float,
    devices: Iterable[str],
    assets: Path,
    scene_folder: Path | None = None,
    shadow_rays: int = 0,
) -> tuple[EffectsMeasured | None, tuple[str, ...]]:
    """The table of a picture, and warnings: a picture that is done is not lost because nothing could be measured.

    folder: the picture's own, with its scene. devices: that rendered; the first is measured. shadow_rays: that its hits took,
    0: the scene's.
    """
    request = Request(
        scene=str(folder / "scene.json"),
        assets_folder=str(assets),
        scene_folder=None if scene_folder is None else str(scene_folder),
        time=time,
        device=next(iter(devices), None),
        budget=RECEIPT_BUDGET,
        shadow_rays=shadow_rays,
    )
    try:
        return measure_effects(request), ()
    except MeasureError as error:
        log.warning("effects cannot be measured: %s", error)
        return None, (f"what effects cost could not be measured: {str(error).splitlines()[0]}",)
