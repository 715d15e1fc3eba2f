"""`penumbra compare`: one scene with several samplers, error against seconds, measured against a long reference.

Every point is a render of its own, since samplers that plan ahead (strata) are at their best where the number of
samples is known beforehand. Seconds are those of tracing, summed over the devices and divided by their number.
"""

from __future__ import annotations

import csv
import json
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from penumbra_scene.adaptive import Adaptive
from penumbra_scene.check import check_scene, scene_hash
from penumbra_scene.scene import Scene
from penumbra_scene.settings import Stop

from penumbra_service.accuracy.reference import Picture, Reference, own_relmse, picture_of, relmse_ref
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.runner import JobRunner, RenderTask, RunResult
from penumbra_service.engine.task import RunFailedError
from penumbra_service.images.thumbnail import write_thumbnail

SAMPLES: Final = (16, 32, 64, 128, 256)
BASELINE: Final = "independent"
"""Whose error the others' seconds are told for, where it is among them; else the first."""


@dataclass(frozen=True)
class Setting:
    """One curve."""

    sampler: str
    adaptive: bool

    @property
    def name(self) -> str:
        return self.sampler + (" adaptive" if self.adaptive else "")


@dataclass(frozen=True)
class Measured:
    """One render."""

    samples: float
    """A pixel, on average, those that only decided included."""
    seconds: float
    relmse_ref: float | None
    """Mean of (m - ref)^2 / (ref^2 + 0.01), less what the reference's own variance adds; None: so small that the reference
    cannot tell it from nothing."""
    relmse: float | None
    """As the render estimates it from itself."""
    relmse_ref_below: float | None = None
    """What it is below, where the reference tells no more."""


@dataclass
class Curve:
    """A setting's renders, and what they come to."""

    setting: Setting
    points: list[Measured] = field(default_factory=list)
    left_out: str = ""
    """Why there are none."""

    @property
    def told(self) -> list[tuple[float, float]]:
        """(seconds, relmse_ref) of the points whose error the reference can tell."""
        return [(p.seconds, p.relmse_ref) for p in self.points if p.relmse_ref is not None and p.seconds > 0]

    @property
    def slope(self) -> float | None:
        """Of log relmse_ref against log seconds, least squares; -1 is plain Monte Carlo. None for fewer than two points."""
        if len(self.told) < 2:
            return None
        seconds, errors = zip(*self.told, strict=True)
        return float(np.polyfit(np.log(seconds), np.log(errors), 1)[0])

    def seconds_to(self, relmse: float) -> float | None:
        """Where the curve, straight between its points on both logarithms, meets an error; beyond its last point
        as it fell there. None for a curve that does not fall, or that begins below."""
        for (before, a), (after, b) in pairwise(self.told):
            last = (after, b) == self.told[-1]
            if a > b and (b <= relmse or last) and a >= relmse:
                share = math.log(a / relmse) / math.log(a / b)
                return float(before * (after / before) ** share)
        return None


@dataclass
class Comparison:
    """All curves of one scene."""

    scene: str
    scene_hash: str
    width: int
    height: int
    device: str
    reference_samples: int
    reference_relmse: float
    """The reference's own, as it estimates it."""
    curves: list[Curve]
    pictures: dict[str, Path] = field(default_factory=dict)
    """By name of the setting, all rendered in about `equal_seconds`."""
    equal_seconds: float = 0.0

    @property
    def baseline(self) -> Curve | None:
        drawn = [curve for curve in self.curves if curve.points]
        named = [curve for curve in drawn if curve.setting == Setting(BASELINE, False)]
        return next(iter(named or drawn), None)

    def gain(self, curve: Curve) -> float | None:
        """Its seconds over the baseline's to the error that the baseline reaches with its most samples, of those errors that
        the reference can tell; None where it does not get there, or the baseline has none."""
        if self.baseline is None or not self.baseline.told:
            return None
        seconds, target = self.baseline.told[-1]
        if curve is self.baseline:
            return 1.0
        ours = curve.seconds_to(target)
        return None if ours is None else ours / seconds


Say = Callable[[str], None]


class Comparer:
    """Renders on one engine. `work`: for the renders' files."""

    def __init__(
        self, engine: Engine, work: Path, assets: Path, beside: Path | None, time: float = 0.0
    ) -> None:
        self._engine = engine
        self._work = work
        self._assets = assets
        self._beside = beside
        self._time = time
        self._count = 0

    def compare(
        self,
        scene: Scene,
        settings: Sequence[Setting],
        reference: Reference,
        samples: Sequence[int] = SAMPLES,
        say: Say = lambda text: None,
    ) -> Comparison:
        """Raises RunFailedError, OSError."""
        say(f"{scene.name}: reference of {reference.samples} samples")
        truth = reference.get(scene, self._time, self.render)
        curves = []
        for setting in settings:
            say(f"{scene.name}: {setting.name}")
            curves.append(self._curve(scene, setting, truth, samples))
        film = scene.film.window
        return Comparison(
            scene=scene.name,
            scene_hash=scene_hash(scene),
            width=film.width,
            height=film.height,
            device=", ".join(d.name for d in self._engine.usable()),
            reference_samples=reference.samples,
            reference_relmse=own_relmse(truth),
            curves=curves,
        )

    def _curve(self, scene: Scene, setting: Setting, truth: Picture, samples: Sequence[int]) -> Curve:
        curve = Curve(setting)
        for count in samples:
            asked = as_set(scene, setting, count)
            refused = [e for e in check_scene(asked, allow_files=True) if not e.warning]
            if refused:
                curve.left_out = refused[0].message
                break
            picture, result = self.render(asked)
            curve.points.append(self._measured(picture, result, truth))
        return curve

    def _measured(self, picture: Picture, result: RunResult, truth: Picture) -> Measured:
        record = result.record
        last = record.points[-1] if record.points else None
        known = last is not None and math.isfinite(last.relmse)
        told = relmse_ref(picture, truth)
        return Measured(
            samples=float(picture.samples),
            seconds=record.trace_seconds / max(len(record.devices), 1),
            relmse_ref=told.relmse if told.known else None,
            relmse=last.relmse if known and last is not None else None,
            relmse_ref_below=None if told.known else told.bound,
        )

    def render(self, scene: Scene) -> tuple[Picture, RunResult]:
        """One render of a scene as it is. Raises RunFailedError."""
        self._count += 1
        with tempfile.TemporaryDirectory(dir=self._work) as folder:
            task = RenderTask(
                f"compare-{self._count}",
                scene,
                Path(folder),
                assets_folder=self._assets,
                scene_folder=self._beside,
                time=self._time,
                program="specialised",  # seconds of few and of many samples are to be of one program
            )
            result = JobRunner(self._engine, task).run()
            if result.failure is not None:
                raise RunFailedError(result.failure.kind, result.failure.message)
            return picture_of(result), result

    def at_equal_time(self, scene: Scene, found: Comparison, out: Path) -> None:
        """Pictures of every setting in the time that the fastest took for its most samples."""
        drawn = [curve for curve in found.curves if curve.points]
        if not drawn:
            return
        found.equal_seconds = min(curve.points[-1].seconds for curve in drawn)
        out.mkdir(parents=True, exist_ok=True)
        look = scene.film.thumbnail
        for curve in drawn:
            count = samples_in(curve, found.equal_seconds)
            picture, _ = self.render(as_set(scene, curve.setting, count))
            path = out / f"{curve.setting.name.replace(' ', '_')}.png"
            write_thumbnail(
                path,
                picture.rgb.astype(np.float32),
                exposure=look.exposure,
                view=look.view,
                max_side=look.max_side,
            )
            found.pictures[curve.setting.name] = path


def samples_in(curve: Curve, seconds: float) -> int:
    """Samples a pixel that a setting takes in so many seconds, at the rate of its largest render; 8 at least."""
    last = curve.points[-1]
    return max(8 * round(last.samples * seconds / last.seconds / 8), 8)


def as_set(scene: Scene, setting: Setting, samples: int) -> Scene:
    """The scene with a setting's sampler, and a stop rule of samples alone."""
    return scene.model_copy(
        update={
            "sampler": scene.sampler.model_copy(update={"type": setting.sampler}),
            # As a job to an error has it: the axis is seconds, not samples.
            "adaptive": Adaptive(shadow_rays="at_most") if setting.adaptive else None,
            "stop": Stop(samples=samples),
        }
    )


def settings_of(samplers: Sequence[str], adaptive: Sequence[bool]) -> list[Setting]:
    """Every sampler with every choice."""
    return [Setting(sampler, choice) for sampler in samplers for choice in adaptive]


def as_json(found: Comparison) -> dict[str, Any]:
    """All numbers."""
    return {
        "scene": found.scene,
        "scene_hash": found.scene_hash,
        "width": found.width,
        "height": found.height,
        "device": found.device,
        "reference": {"samples": found.reference_samples, "relmse": found.reference_relmse},
        "equal_seconds": found.equal_seconds,
        "curves": [
            {
                "sampler": curve.setting.sampler,
                "adaptive": curve.setting.adaptive,
                "slope": curve.slope,
                "seconds_over_baseline": found.gain(curve),
                "left_out": curve.left_out or None,
                "points": [asdict(point) for point in curve.points],
            }
            for curve in found.curves
        ],
    }


def write_numbers(found: Comparison, out: Path) -> None:
    """compare.json and compare.csv. Raises OSError."""
    (out / "compare.json").write_text(json.dumps(as_json(found), indent=1) + "\n", encoding="utf-8")
    with (out / "compare.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["sampler", "adaptive", "samples", "seconds", "relmse_ref", "relmse", "relmse_ref_below"]
        )
        writer.writerows(_rows(found))


def _rows(found: Comparison) -> Iterator[list[Any]]:
    for curve in found.curves:
        for p in curve.points:
            kind = "on" if curve.setting.adaptive else "off"
            errors = [p.relmse_ref, p.relmse, p.relmse_ref_below]
            yield [curve.setting.sampler, kind, p.samples, p.seconds, *errors]
