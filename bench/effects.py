"""`make effects`: what leaving effects out saves, for every example; writes docs/effects.md and its plot.

Each example is traced by its own program and by the generic one, in turns, on the same blocks; the least of several timings
counts, since whatever else the machine does only adds. Programs are compiled cold by a compiler process whose own start is
not counted, as a device has it from its second program on. Seconds, bytes, metres.
"""

from __future__ import annotations

import argparse
import datetime
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from clock import clock, cores
from meshes import knot
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.blocks import blocks_of
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.compiler import Compiler, is_cached
from penumbra_kernels.device import Device
from penumbra_kernels.dimensions import numbers_drawn
from penumbra_kernels.features import Features, analyse
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import MEASURING, Flags, SamplePlan, Tracer
from penumbra_scene.measured import EffectsMeasured
from penumbra_scene.parse import parse_scene
from penumbra_scene.scene import Scene
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.measure_process import Measurement
from penumbra_service.engine.runner import JobRunner, RenderTask
from penumbra_service.images.assets import FolderAssets
from penumbra_service.measuring import Request
from scenes import HeldMeshes

ROOT: Final = Path(__file__).resolve().parent.parent
EXAMPLES: Final = ROOT / "examples"
PAGE: Final = ROOT / "docs" / "effects.md"
PLOT: Final = ROOT / "docs" / "pictures" / "effects.png"
REPLICATES: Final = 8
BLOCKS: Final = 64
ROUNDS: Final = 7
ROUND_SECONDS: Final = 0.04
LARGE: Final = 1.1
"""Speed of a specialised program against the generic one that the page calls large, and `NOTHING` where it calls it none."""
NOTHING: Final = 1.02
PROMISED: Final = 0.98
NOISE_SCENES: Final = ("soft_shadows", "glossy", "depth_of_field", "all_effects")
NOISE_SECONDS: Final = 5.0


@dataclass(frozen=True)
class Row:
    """One example, by its own program and by the generic one."""

    name: str
    effects: int
    microseconds: tuple[float, float]
    """Of a camera path."""
    cold: tuple[float, float]
    """Seconds of compiling."""
    warm: float
    bytes: tuple[int, int]
    numbers: tuple[int, int]
    rays: float
    """Of a camera path."""

    @property
    def gain(self) -> float:
        return self.microseconds[1] / self.microseconds[0]


def read(name: str) -> Scene:
    return parse_scene((EXAMPLES / f"{name}.json").read_bytes(), allow_files=True)


def blocks_in(scene: Scene) -> list[Tile]:
    window = scene.film.window
    return blocks_of(Tile(window.x, window.y, window.width, window.height), BLOCKS)


class ColdCompiler:
    """Seconds that programs take from an empty cache; each is built once."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._compiler = Compiler(device.info.id)
        self._known: dict[tuple[tuple[str, int], ...], float] = {}
        features = analyse(read("classic"))
        self.first = self.seconds({**features.flags(), **MEASURING})
        """The first program of a process, whose compiler has to start."""

    def seconds(self, flags: Flags) -> float:
        key = tuple(sorted(flags.items()))
        if key not in self._known:
            assert not is_cached(self._device, flags)
            self._compiler.order(flags)
            built = self._compiler.answer()
            assert built is not None
            assert built.built, built.problem
            self._known[key] = built.seconds
        return self._known[key]

    def close(self) -> None:
        self._compiler.close()


def least_microseconds(tracers: Sequence[Tracer], scene: Scene) -> tuple[float, ...]:
    """Of a camera path by each of the tracers, in turns."""
    blocks = blocks_in(scene)

    def seconds(tracer: Tracer, count: int) -> float:
        started = clock()
        for block in blocks:
            tracer.trace(block, 0, count)
        return clock() - started

    count = 1
    while seconds(tracers[0], count) < ROUND_SECONDS and count < 64:
        count *= 2
    rounds = [[seconds(tracer, count) for tracer in tracers] for _ in range(ROUNDS)]
    paths = sum(block.width * block.height for block in blocks) * REPLICATES * count
    return tuple(1e6 * min(values) / paths for values in zip(*rounds, strict=True))


def rays_per_path(tracer: Tracer, scene: Scene) -> float:
    taken = rays = 0
    for block in blocks_in(scene):
        sums = tracer.trace(block, 0, 2).sums
        taken += int(sums["taken"].sum() + sums["rejected"].sum())
        rays += int(sums["rays"].sum())
    return rays / taken


def measure(device: Device, compiler: ColdCompiler, name: str, folder: Path) -> Row:
    scene = read(name)
    features = analyse(scene)
    cold = (compiler.seconds(features.flags()), compiler.seconds(features.generic_flags()))
    compiled = compile_scene(scene, FolderAssets(folder, EXAMPLES))
    plan = SamplePlan(REPLICATES, 8)
    own, generic = (Tracer(device, compiled, plan, program=p) for p in ("specialised", "generic"))
    first, second = least_microseconds((own, generic), scene)
    return Row(
        name,
        len(features.present),
        (first, second),
        cold,
        own.compile_seconds,
        (own.scene_bytes, generic.scene_bytes),
        numbers_drawn(features),
        rays_per_path(own, scene),
    )


def million(device: Device) -> dict[str, float]:
    """Microseconds of a camera path through a million still triangles: alone, with a square that stands still, and with one
    that moves."""
    meshes = HeldMeshes()
    base: dict[str, Any] = {
        "version": 1,
        "camera": {
            "type": "perspective",
            "transform": {"look_at": {"origin": [0, 0, 6], "target": [0, 0, 0]}},
            "shutter": {"open": 0, "close": 1},
        },
        "film": {"width": 128, "height": 128},
        "integrator": {"max_bounces": 2},
        "environment": {"type": "constant"},
    }
    mesh = {"type": "mesh", "source": meshes.add(*knot(1_000_000))}
    square = {"type": "quad", "origin": [-2.4, -2.4, 0], "u": [0.5, 0, 0], "v": [0, 0.5, 0]}
    move = {"keyframes": [{"time": t, "transform": [{"translate": [t, 0, 0]}]} for t in (0, 1)]}
    shapes = {"alone": [mesh], "still": [mesh, square], "moving": [mesh, {**square, "transform": move}]}
    scenes = {name: Scene.model_validate({**base, "shapes": found}) for name, found in shapes.items()}
    trees = Trees()
    tracers = [
        Tracer(device, compile_scene(scene, meshes, 0.0, trees), SamplePlan(REPLICATES, 8))
        for scene in scenes.values()
    ]
    return dict(zip(scenes, least_microseconds(tracers, scenes["alone"]), strict=True))


def simplest(compiler: ColdCompiler) -> tuple[float, float]:
    """Cold compile of the simplest scene, a point light and a square without bounces, and of its generic program."""
    scene = {
        "version": 1,
        "camera": {"type": "perspective"},
        "integrator": {"max_bounces": 0},
        "shapes": [{"type": "quad"}],
        "lights": [{"type": "point"}],
    }
    features: Features = analyse(Scene.model_validate(scene))
    return compiler.seconds(features.flags()), compiler.seconds(features.generic_flags())


def warm_start(folder: Path) -> tuple[float, float]:
    """Seconds from an engine's start, its programs in the cache, to a device that is ready, and from there to the first sample
    of the Cornell box on the film."""
    scene = read("cornell")
    stop = scene.stop.model_copy(update={"samples": 8, "seconds": None, "relative_error": None})
    film = scene.film.model_copy(update={"width": 64, "height": 64, "crop": None})
    small = scene.model_copy(update={"stop": stop, "film": film})
    started = time.perf_counter()
    with LocalEngine() as engine:
        engine.wait_known()
        while not any(device.state == "idle" for device in engine.devices()):
            time.sleep(0.001)
        ready = time.perf_counter()
        JobRunner(engine, RenderTask("warm", small, folder / "warm")).run()
        return ready - started, time.perf_counter() - ready


def noise(name: str, device: Device, folder: Path) -> EffectsMeasured:
    path = str(EXAMPLES / f"{name}.json")
    request = Request(path, str(folder), str(EXAMPLES), 0.0, None, NOISE_SECONDS)
    return Measurement(request, device).result()


def table(rows: Sequence[Row]) -> list[str]:
    lines = [
        "| scene | effects in | us a path: own | generic | own is faster by | compile cold, s: own | generic | warm, ms "
        "| scene data, KiB: own | generic | numbers drawn | rays a path |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| `{row.name}` | {row.effects} | {row.microseconds[0]:.3f} | {row.microseconds[1]:.3f} | {row.gain:.2f} "
        f"| {row.cold[0]:.2f} | {row.cold[1]:.2f} | {1e3 * row.warm:.0f} | {row.bytes[0] / 1024:.1f} "
        f"| {row.bytes[1] / 1024:.1f} | {row.numbers[0]} + {row.numbers[1]} | {row.rays:.2f} |"
        for row in rows
    ]
    return lines


def _names(rows: Sequence[Row]) -> str:
    return ", ".join(f"`{row.name}` {row.gain:.2f}" for row in rows) or "none"


def findings(rows: Sequence[Row]) -> list[str]:
    """What is large and what is nothing, by the numbers of this run."""
    by_gain = sorted(rows, key=lambda row: -row.gain)
    large = [row for row in by_gain if row.gain >= LARGE]
    nothing = [row for row in by_gain if PROMISED <= row.gain < NOTHING]
    slower = [row for row in by_gain if row.gain < PROMISED]
    ratios = [row.cold[0] / row.cold[1] for row in rows]
    saved = [1 - row.bytes[0] / row.bytes[1] for row in rows]
    return [
        f"- **Time to trace.** Large (a tenth and more) in {len(large)} of {len(rows)} scenes: {_names(large)}.",
        f"- Next to nothing (less than 2 %) in {len(nothing)}: {_names(nothing)}.",
        f"- Slower than {PROMISED} of the generic program: {_names(slower)}.",
        f"- **Compiling.** A scene's own program takes {min(ratios):.2f} to {max(ratios):.2f} of the generic one's time.",
        f"- **Scene data.** {100 * min(saved):.1f} to {100 * max(saved):.1f} % less: nothing beside meshes and textures; what "
        "counts is that an effect that is out has no buffer at all.",
        "- **Random numbers.** A pinhole draws no lens, a still scene no time, a single light no choice, a mirror no lobe: the "
        "column gives them for the camera's ray and, at most, for a hit.",
    ]


def _noise_table(measured: dict[str, EffectsMeasured]) -> list[str]:
    groups = ("pixel", "lens", "time", "lights", "directions", "interactions")
    lines = ["| scene | " + " | ".join(groups) + " | sum |", "|---" * (len(groups) + 2) + "|"]
    for name, found in measured.items():
        rows = {row.group: row for row in found.noise}
        cells = [
            f"{100 * rows[g].alone:.0f} +- {100 * rows[g].error:.0f}" if g in rows else "" for g in groups
        ]
        total = 100 * sum(row.alone for row in found.noise)
        lines.append(f"| `{name}` | " + " | ".join(cells) + f" | {total:.0f} |")
    return lines


def _cost_table(measured: dict[str, EffectsMeasured]) -> list[str]:
    lines = ["| scene | effect | us a path with | without | share of the time |", "|---|---|---|---|---|"]
    lines += [
        f"| `{name}` | {cost.effect} | {1e6 * cost.seconds:.3f} | {1e6 * cost.seconds_without:.3f} "
        f"| {100 * cost.share:.0f} % |"
        for name, found in measured.items()
        for cost in found.costs
    ]
    return lines


def plot(rows: Sequence[Row]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    ordered = sorted(rows, key=lambda row: row.gain)
    y = np.arange(len(ordered))
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 0.26 * len(ordered) + 1.2), sharey=True)
    left.barh(y, [row.gain for row in ordered], color="#4878a8")
    left.axvline(1.0, color="black", linewidth=0.8)
    left.set_yticks(y, [row.name for row in ordered], fontsize=8)
    left.set_xlabel("samples a second, own program / generic")
    right.barh(y + 0.2, [row.cold[1] for row in ordered], 0.4, color="#c8b090", label="generic")
    right.barh(y - 0.2, [row.cold[0] for row in ordered], 0.4, color="#4878a8", label="own")
    right.set_xlabel("cold compile, s")
    right.legend(fontsize=8, loc="lower right")
    figure.tight_layout()
    figure.savefig(PLOT, dpi=100)


def page(
    device: Device, rows: Sequence[Row], extra: Sequence[str], measured: dict[str, EffectsMeasured]
) -> str:
    info = device.info
    target = f", {info.target}" if info.target else ""
    machine = f"{info.name} ({cores()} cores{target})"
    return "\n".join(
        [
            "# What effects cost, measured",
            "",
            "A scene's own program has just the effects that it calls for; the generic one has all, and gives the same bits. "
            f"On {machine}, {info.platform_version}, {datetime.date.today().isoformat()}. `make effects` makes this page; "
            "`penumbra explain scene.json --measure` makes the last two tables for any scene.",
            "",
            "![Speed and compile time by scene](pictures/effects.png)",
            "",
            "## Large, and nothing",
            "",
            *findings(rows),
            "",
            "## What was expected",
            "",
            *extra,
            "",
            "## Every example",
            "",
            *table(rows),
            "",
            "## Shares of the noise, per cent",
            "",
            "Of the variance of a replicate's mean at 8 samples, by first-order sensitivity indices "
            "([decision 17](decisions/0017-what-effects-cost-is-asked-for.md)); a share of one group alone can come out below "
            "0 by its error. `interactions` is what several groups do together.",
            "",
            *_noise_table(measured),
            "",
            "## Seconds, with an effect and without",
            "",
            "Without means the plain thing in its place: a pinhole, a closed shutter, paint for metal or glass. It can cost "
            "more.",
            "",
            *_cost_table(measured),
            "",
        ]
    )


def expected(device: Device, rows: Sequence[Row], compiler: ColdCompiler, folder: Path) -> list[str]:
    own, generic = simplest(compiler)
    triangles = million(device)
    still = triangles["still"] / triangles["alone"] - 1
    moving = triangles["moving"] / triangles["still"] - 1
    ready, sample = warm_start(folder)
    worst = min(rows, key=lambda row: row.gain)
    found = [
        (
            "own program against generic, samples a second, worst scene",
            ">= 0.98",
            f"{worst.gain:.2f}, `{worst.name}`",
        ),
        (
            "cold compile, simplest scene / generic",
            "<= 0.33",
            f"{own / generic:.2f} ({own:.2f} s / {generic:.2f} s)",
        ),
        (
            "a still scene against a build without motion",
            "within 1 %",
            "one program: its text has no motion in it",
        ),
        ("a million still triangles, and a still square", "", f"{100 * still:+.1f} % for the square"),
        ("the same, and the square moves", "< 10 %", f"{100 * moving:+.1f} % for its motion"),
        ("warm start: a device's process is ready", "", f"{ready:.2f} s"),
        ("from there to the first 8 samples of 64 x 64 pixels on the film", "< 0.5 s", f"{sample:.2f} s"),
        (
            "the first program that a compiler's process builds, `classic`",
            "",
            f"{compiler.first:.2f} s: LLVM starts",
        ),
    ]
    return ["| what | wanted | measured |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in found)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", help="only these examples; then nothing is written (default: all)"
    )
    arguments = parser.parse_args()
    names = arguments.names or sorted(path.stem for path in EXAMPLES.glob("*.json"))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ["PENUMBRA_CACHE"] = str(folder / "cache")
        device = Device()
        compiler = ColdCompiler(device)
        try:
            rows = []
            for name in names:
                rows.append(measure(device, compiler, name, folder))
                print("\n".join(table(rows[-1:])[2:]), flush=True)
            if arguments.names:
                return
            extra = expected(device, rows, compiler, folder)
            measured = {name: noise(name, device, folder) for name in NOISE_SCENES}
        finally:
            compiler.close()
    PAGE.write_text(page(device, rows, extra, measured))
    plot(rows)


if __name__ == "__main__":
    main()
