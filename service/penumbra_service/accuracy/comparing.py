"""`penumbra compare`: from a scene file to numbers, plots and pictures in a folder."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from penumbra_scene import limits
from penumbra_scene.parse import parse_scene
from penumbra_scene.scene import Scene

from penumbra_service.accuracy.compare import (
    SAMPLES,
    Comparer,
    Comparison,
    Curve,
    Measured,
    Say,
    Setting,
    settings_of,
    write_numbers,
)
from penumbra_service.accuracy.plots import plot_all
from penumbra_service.accuracy.reference import Reference
from penumbra_service.engine.protocol import Engine
from penumbra_service.rendering import assets_folder, local_engine

REFERENCE_FACTOR = 16
"""Samples of the reference over the most that is measured against it."""


@dataclass(frozen=True)
class Wanted:
    """What to compare."""

    samplers: tuple[str, ...]
    adaptive: tuple[bool, ...] = (False,)
    samples: tuple[int, ...] | None = None
    reference: int | None = None
    size: tuple[int, int] | None = None
    time: float = 0.0
    devices: str = ""
    plots: bool = True
    settings: tuple[Setting, ...] = ()
    """In place of every sampler with every choice of `adaptive`."""


def compare_file(path: Path, wanted: Wanted, out: Path, say: Say) -> Comparison:
    """Compare on this machine, and write everything into `out`.

    Raises ProblemError where the file is no scene, RunFailedError, CommandError, OSError.
    """
    scene = resized(parse_scene(path.read_bytes(), allow_files=True), wanted.size)
    out.mkdir(parents=True, exist_ok=True)
    with local_engine(wanted.devices) as engine:
        found = compare_on(engine, scene, path.parent, wanted, out / "pictures", say)
    write_numbers(found, out)
    if wanted.plots:
        plot_all(found, {"curves": out / "curves.png", "pictures": out / "pictures.png"})
    return found


def compare_on(
    engine: Engine, scene: Scene, beside: Path, wanted: Wanted, pictures: Path, say: Say
) -> Comparison:
    """The same on an engine that runs already, without the files but the pictures."""
    samples = wanted.samples or SAMPLES
    reference = Reference(wanted.reference or min(REFERENCE_FACTOR * max(samples), limits.MAX_SAMPLES))
    with tempfile.TemporaryDirectory(prefix="penumbra-") as work:
        comparer = Comparer(engine, Path(work), assets_folder(), beside, wanted.time)
        found = comparer.compare(
            scene, wanted.settings or settings_of(wanted.samplers, wanted.adaptive), reference, samples, say
        )
        say(f"{scene.name}: pictures at equal time")
        comparer.at_equal_time(scene, found, pictures)
    return found


def resized(scene: Scene, size: tuple[int, int] | None) -> Scene:
    """The scene's picture in another size, whole and without layers."""
    film = scene.film.model_copy(update={"layers": ()})
    if size is not None:
        film = film.model_copy(update={"width": size[0], "height": size[1], "crop": None})
    return scene.model_copy(update={"film": film})


def in_words(found: Comparison, out: Path) -> str:
    """A line for each curve."""
    base = found.baseline
    lines = [
        f"{found.scene}: {found.width} x {found.height} on {found.device}, against {found.reference_samples} samples"
    ]
    lines += [_line(found, curve) for curve in found.curves]
    if base is not None:
        lines.append(f"`of the seconds`: to the error of {base.setting.name} with its most samples")
    if any(point.relmse_ref is None for curve in found.curves for point in curve.points):
        lines.append("a longer reference tells smaller errors: --reference N")
    return "\n".join([*lines, f"results in {out}"])


def _line(found: Comparison, curve: Curve) -> str:
    if not curve.points:
        return f"{curve.setting.name:20} left out: {curve.left_out}"
    last = curve.points[-1]
    return (
        f"{curve.setting.name:20} relMSE {_error(last)} after {last.samples:.0f} samples, {last.seconds:.2f} s; "
        f"{_slope(curve)}; {_share(found, curve)}"
    )


def _error(point: Measured) -> str:
    if point.relmse_ref is not None:
        return f"{point.relmse_ref:.3g}"
    return f"below {point.relmse_ref_below:.2g}, which is as little as the reference can tell,"


def _slope(curve: Curve) -> str:
    if curve.slope is not None:
        return f"slope {curve.slope:.2f}"
    if len(curve.points) < 2:
        return "no slope of one number of samples"
    return "no slope: the reference can tell fewer than two of its errors"


def _share(found: Comparison, curve: Curve) -> str:
    gain = found.gain(curve)
    if gain is not None:
        return f"{gain:.2f} of the seconds"
    if found.baseline is None or not found.baseline.told or not curve.told:
        return "seconds cannot be compared"
    return "never as little error"
