"""Quotes against what came of them, in seconds: every example with a random sampler, quoted on an empty cache of programs,
rendered to an error, and quoted again."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from penumbra_kernels.cache import VARIABLE
from penumbra_scene.quote import Quote
from penumbra_scene.scene import Scene
from penumbra_scene.settings import Stop
from penumbra_service.engine.pilot import PilotRunner, PilotTask
from penumbra_service.engine.protocol import Engine, ServedEngine
from penumbra_service.engine.runner import JobRunner, RenderTask
from penumbra_service.film.replicates import DETERMINISTIC_SAMPLERS
from penumbra_service.jobs.pilot import PilotResult
from penumbra_service.jobs.quote import build_quote
from penumbra_service.rendering import assets_folder, local_engine

SECONDS: Final = (0.7, 5.0)
"""A target is taken that should take so long."""
HOLDS: Final = 1.5
QUOTES: Final = ("cold", "warm")
"""Before the scene's program was built, and after."""
LONGEST: Final = 20.0
"""Seconds after which a render is ended that has not met its error: ten times what it was to take."""


@dataclass(frozen=True)
class Told:
    """A quote."""

    samples: float
    seconds: float
    between: tuple[float, float | None]
    """The seconds' interval; without an upper end the quote says 'at least'."""
    pilot_samples: float
    """A pixel."""
    pilot_seconds: float
    compile_seconds: float

    @property
    def bounded(self) -> bool:
        """Whether it knows an upper end."""
        return self.between[1] is not None

    def holds(self, seconds: float) -> bool:
        """Whether so many lie in the interval."""
        low, high = self.between
        return low <= seconds and (high is None or seconds <= high)


@dataclass(frozen=True)
class Forecast:
    """Of one scene: what was quoted before its program was there and again after its render, and what that took."""

    scene: str
    target: float
    cold: Told
    warm: Told
    samples: float
    seconds: float
    met: bool = True
    """Whether the render met its error; else it was ended after LONGEST, and what is real is more."""

    @classmethod
    def read(cls, kept: Mapping[str, Any]) -> Forecast:
        """From JSON."""
        told = {name: Told(**{**kept[name], "between": tuple(kept[name]["between"])}) for name in QUOTES}
        return cls(**{**kept, **told})

    def told(self, when: str) -> Told:
        """One of QUOTES."""
        return self.cold if when == "cold" else self.warm

    def samples_ratio(self, when: str) -> float:
        """Quoted over real."""
        return self.told(when).samples / self.samples

    def seconds_ratio(self, when: str) -> float:
        """Quoted over real."""
        return self.told(when).seconds / self.seconds


def holds(ratio: float) -> bool:
    """Within x1.5."""
    return 1 / HOLDS <= ratio <= HOLDS


@contextmanager
def cold_engine() -> Iterator[ServedEngine]:
    """This machine's devices, with an empty cache of programs."""
    before = os.environ.get(VARIABLE)
    with tempfile.TemporaryDirectory(prefix="penumbra-", ignore_cleanup_errors=True) as folder:
        os.environ[VARIABLE] = folder
        try:
            with local_engine("") as engine:
                yield engine
        finally:
            del os.environ[VARIABLE]
            if before is not None:
                os.environ[VARIABLE] = before


def forecast(engine: Engine, scene: Scene, beside: Path) -> Forecast | None:
    """None where the sampler has no error or the picture no noise. Raises RunFailedError, OSError."""
    if scene.sampler.type in DETERMINISTIC_SAMPLERS:
        return None
    assets = assets_folder()

    def pilot(of: Scene) -> PilotResult:
        with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
            return PilotRunner(engine, PilotTask(of, Path(folder), assets, beside)).run()

    plain = scene.model_copy(update={"stop": Stop(samples=16)})
    cold = pilot(plain)
    target = _target(build_quote(plain, 0.0, cold))
    if target is None:
        return None
    asked = scene.model_copy(update={"stop": Stop(relative_error=target)})
    capped = scene.model_copy(update={"stop": Stop(relative_error=target, seconds=LONGEST)})
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        result = JobRunner(engine, RenderTask("forecast", capped, Path(folder), assets, beside)).run()
    real = result.record.points[-1]
    return Forecast(
        scene.name,
        target,
        _told(asked, cold),
        _told(asked, pilot(asked)),
        float(real.samples),
        real.seconds,
        result.reason == "relative_error",
    )


def _told(scene: Scene, found: PilotResult) -> Told:
    quote = build_quote(scene, 0.0, found)
    end, ends = quote.end, quote.end.seconds_interval
    return Told(
        samples=end.samples,
        seconds=end.seconds,
        between=(ends.low, ends.high),
        pilot_samples=quote.pilot.samples,
        pilot_seconds=quote.pilot.seconds,
        compile_seconds=0.0 if quote.compile.warm else quote.compile.seconds,
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


def summary(found: Sequence[Forecast], when: str) -> dict[str, float]:
    """Shares that hold, of what was quoted `when`."""
    n = max(len(found), 1)
    return {
        "samples": sum(holds(f.samples_ratio(when)) for f in found) / n,
        "seconds": sum(holds(f.seconds_ratio(when)) for f in found) / n,
        "within": sum(f.told(when).holds(f.seconds) for f in found) / n,
    }
