"""Quotes against what came of them, in seconds: every example with a random sampler, rendered to an error."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from penumbra_scene.quote import Quote
from penumbra_scene.scene import Scene
from penumbra_scene.settings import Stop
from penumbra_service.engine.pilot import PilotRunner, PilotTask
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.runner import JobRunner, RenderTask
from penumbra_service.film.replicates import DETERMINISTIC_SAMPLERS
from penumbra_service.jobs.quote import build_quote
from penumbra_service.rendering import assets_folder

SECONDS: Final = (0.7, 5.0)
"""A target is taken that should take so long."""
HOLDS: Final = 1.5
LONGEST: Final = 20.0
"""Seconds after which a render is ended that has not met its error: ten times what it was to take."""


@dataclass(frozen=True)
class Forecast:
    """Of one scene."""

    scene: str
    target: float
    pilot_seconds: float
    samples: tuple[float, float]
    """Quoted, real."""
    seconds: tuple[float, float]
    within: bool
    """Whether the real seconds lie in the interval that was quoted."""
    bounded: bool = True
    """Whether that has an upper end; else the quote says 'at least'."""
    met: bool = True
    """Whether the render met its error; else it was ended after LONGEST, and what is real is more."""

    @property
    def samples_ratio(self) -> float:
        return self.samples[0] / self.samples[1]

    @property
    def seconds_ratio(self) -> float:
        return self.seconds[0] / self.seconds[1]


def holds(ratio: float) -> bool:
    """Within x1.5."""
    return 1 / HOLDS <= ratio <= HOLDS


def forecast(engine: Engine, scene: Scene, beside: Path) -> Forecast | None:
    """None where the sampler has no error or the picture no noise. Raises RunFailedError, OSError."""
    if scene.sampler.type in DETERMINISTIC_SAMPLERS:
        return None
    scene = scene.model_copy(update={"stop": Stop(samples=16)})
    assets = assets_folder()
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        found = PilotRunner(engine, PilotTask(scene, Path(folder) / "pilot", assets, beside)).run()
        target = _target(build_quote(scene, 0.0, found))
        if target is None:
            return None
        scene = scene.model_copy(update={"stop": Stop(relative_error=target)})
        quote = build_quote(scene, 0.0, found)
        scene = scene.model_copy(update={"stop": Stop(relative_error=target, seconds=LONGEST)})
        result = JobRunner(engine, RenderTask("forecast", scene, Path(folder) / "job", assets, beside)).run()
    real = result.record.points[-1]
    high = quote.end.seconds_interval.high
    return Forecast(
        scene.name,
        target,
        found.seconds,
        (quote.end.samples, float(real.samples)),
        (quote.end.seconds, real.seconds),
        quote.end.seconds_interval.low <= real.seconds and (high is None or real.seconds <= high),
        high is not None,
        result.reason == "relative_error",
    )


def _target(quote: Quote) -> float | None:
    """The error that should take about the middle of SECONDS: of the table's power law."""
    rows = [row for row in quote.table if row.seconds > 0]
    if not rows or quote.theta is None:
        return None
    middle = (SECONDS[0] * SECONDS[1]) ** 0.5
    row = min(rows, key=lambda row: abs(row.seconds - middle))
    error = float(row.relative_error * (row.seconds / middle) ** (quote.theta / 2))
    return min(max(error, 1e-4), 0.5)


def summary(found: Sequence[Forecast]) -> dict[str, float]:
    """Shares that hold."""
    n = max(len(found), 1)
    return {
        "samples": sum(holds(f.samples_ratio) for f in found) / n,
        "seconds": sum(holds(f.seconds_ratio) for f in found) / n,
        "within": sum(f.within for f in found) / n,
    }
