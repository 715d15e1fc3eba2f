"""`make effects`: what leaving effects out saves, for every example; writes docs/effects.md and its plot.

Programs are timed on the same blocks in short turns, one after the other and then the other way round, in CPU seconds of the
process, all cores together: what else the machine does is no part of them. Ratios are medians over turns, with a 95 % interval
by bootstrap (Efron and Tibshirani 1993, section 13.3). Programs are compiled cold by a compiler process whose own start is not
counted, as a device has it from its second program on. Seconds, bytes, metres.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from effects_page import PROMISED, NoiseCheck, Ratio, Row, page, plot, table
from meshes import knot
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.blocks import blocks_of
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.compiler import Compiler, is_cached
from penumbra_kernels.device import Device
from penumbra_kernels.dimensions import drawn_per_path, numbers_drawn
from penumbra_kernels.features import Features, analyse
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sensitivity import (
    DETERMINISTIC,
    GROUPS,
    bit_of,
    groups_of,
    half_square,
    shares,
    values_of,
)
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
REPLICATES: Final = 8
BLOCKS: Final = 64
TURNS: Final = 15
"""Where the interval reaches below what was promised, four times as many."""
TURN_SECONDS: Final = 0.03
MILLION_TURNS: Final = 60
COLD_TURNS: Final = 4
SAMPLES: Final = 8
"""A replicate's, where noise is measured."""
NOISE_SCENES: Final = ("soft_shadows", "glossy", "depth_of_field", "all_effects")
NOISE_SECONDS: Final = 5.0


def read(name: str) -> Scene:
    return parse_scene((EXAMPLES / f"{name}.json").read_bytes(), allow_files=True)


def blocks_in(scene: Scene) -> list[Tile]:
    window = scene.film.window
    return blocks_of(Tile(window.x, window.y, window.width, window.height), BLOCKS)


class ColdCompiler:
    """Seconds that programs take from an empty cache; each is built once."""

    def __init__(self, device: Device, number: int = 0) -> None:
        """number: of its kind, so that its first program is no other one's."""
        self._device = device
        self._compiler = Compiler(device.info.id)
        self._known: dict[tuple[tuple[str, int], ...], float] = {}
        features = analyse(read("classic"))
        self.first = self.seconds({**features.flags(), **MEASURING, "PENUMBRA_TURN": number})
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


class Turns:
    """CPU microseconds of a camera path by each of some tracers, turn by turn."""

    def __init__(self, tracers: dict[str, Tracer], scene: Scene, turns: int = TURNS) -> None:
        blocks = blocks_in(scene)

        def seconds(tracer: Tracer, count: int) -> float:
            started = time.process_time()
            for block in blocks:
                tracer.trace(block, 0, count)
            return time.process_time() - started

        count = 1
        while max(seconds(tracer, count) for tracer in tracers.values()) < TURN_SECONDS and count < 64:
            count *= 2
        self._paths = sum(block.width * block.height for block in blocks) * REPLICATES * count
        self._seconds = {name: partial(seconds, tracer, count) for name, tracer in tracers.items()}
        self._values: dict[str, list[float]] = {name: [] for name in tracers}
        self.go_on(turns)

    def go_on(self, turns: int) -> None:
        """Take so many more."""
        for turn in range(turns):
            for name in list(self._values)[:: 1 if turn % 2 else -1]:
                self._values[name].append(1e6 * self._seconds[name]() / self._paths)

    def microseconds(self, name: str) -> float:
        """Of a camera path, the median."""
        return float(np.median(self._values[name]))

    def ratio(self, above: str, below: str) -> Ratio:
        """Of the one's time to the other's."""
        ratios = np.array(self._values[above]) / np.array(self._values[below])
        picks = np.random.default_rng(0).integers(0, len(ratios), (1000, len(ratios)))
        low, high = np.quantile(np.median(ratios[picks], axis=1), (0.025, 0.975))
        return Ratio(float(np.median(ratios)), float(low), float(high))


def itself(device: Device, folder: Path) -> Ratio:
    """The generic program on `all_effects` against itself on buffers of its own: what such a measurement cannot tell apart."""
    scene = read("all_effects")
    compiled = compile_scene(scene, FolderAssets(folder, EXAMPLES))
    plan = SamplePlan(REPLICATES, 8)
    twice = {name: Tracer(device, compiled, plan, program="generic") for name in ("one", "other")}
    return Turns(twice, scene).ratio("one", "other")


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
    generic = Tracer(device, compiled, plan, program="generic")
    own = (
        generic.specialised()
    )  # on the same buffers: where these happen to lie makes a per cent of difference
    turns = Turns({"specialised": own, "generic": generic}, scene)
    if turns.ratio("generic", "specialised").low < PROMISED:
        turns.go_on(3 * TURNS)
    measuring = Tracer(device, compiled, plan, measuring=True)
    return Row(
        name,
        len(features.present),
        (turns.microseconds("specialised"), turns.microseconds("generic")),
        turns.ratio("generic", "specialised"),
        cold,
        own.compile_seconds,
        (own.scene_bytes, generic.scene_bytes),
        numbers_drawn(features),
        sum(drawn_per_path(measuring, blocks_in(scene), 2).values()),
        rays_per_path(own, scene),
        check_noise(scene, own, measuring),
    )


def check_noise(scene: Scene, own: Tracer, measuring: Tracer) -> NoiseCheck | None:
    """The film's variance is of other random numbers."""
    if scene.sampler.type in DETERMINISTIC:
        return None
    blocks, everything = blocks_in(scene), sum(bit_of(group) for group in GROUPS)
    first, second = (values_of(measuring, blocks, SAMPLES, groups) for groups in (0, everything))
    mixed = {g: values_of(measuring, blocks, SAMPLES, bit_of(g)) for g in groups_of(own.compiled.features)}
    own.reseed(int(scene.sampler.seed) ^ 0x5EED)
    film = values_of(own, blocks, SAMPLES, 0).var(axis=1, ddof=1).mean(axis=1)
    difference = half_square(first, second) - film
    error = float(difference.std(ddof=1) / np.sqrt(len(film)))
    rows = shares(first, second, mixed)
    lowest = min((row.alone / row.error for row in rows if row.error), default=0.0)
    mean = float(film.mean())
    return NoiseCheck(1 + float(difference.mean()) / mean, error / mean, lowest) if mean > 0 else None


def million(device: Device) -> Turns:
    """A million still triangles: alone; with a square that stands still ('square'), as an instance of its own ('instance'), and
    that moves half its way to either side, so that it covers as much ('moving'), and turns as well ('turning'); 'motion': the
    still scene by a program that could move things."""
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
    copy = {"type": "instance", "prototype": "square"}
    shapes = {
        "alone": [mesh],
        "square": [mesh, square],
        "instance": [mesh, copy],
        "moving": [mesh, {**square, "transform": motion(0)}],
        "turning": [mesh, {**square, "transform": motion(10)}],
    }
    trees = Trees()
    compiled = {
        name: compile_scene(
            Scene.model_validate(
                {**base, "shapes": found, "prototypes": {"square": [square]} if copy in found else {}}
            ),
            meshes,
            0.0,
            trees,
        )
        for name, found in shapes.items()
    }
    compiled["motion"] = replace(compiled["square"], features=with_motion(compiled["square"].features))
    plan = SamplePlan(REPLICATES, 8)
    tracers = {name: Tracer(device, scene, plan) for name, scene in compiled.items()}
    return Turns(tracers, Scene.model_validate(base), MILLION_TURNS)


def motion(degrees: float) -> dict[str, Any]:
    """A metre along x while the shutter is open, and so many degrees about z."""

    def at(time: float) -> list[dict[str, Any]]:
        angle = degrees * (time - 0.5)
        return [{"rotate": {"axis": [0, 0, 1], "angle": angle}}, {"translate": [time - 0.5, 0, 0]}]

    return {"keyframes": [{"time": time, "transform": at(time)} for time in (0, 1)]}


def with_motion(features: Features) -> Features:
    """As if something moved, the camera, an instance and a mesh's form."""
    motion = ("motion", "camera_motion", "deformation", "instancing")
    verdicts = tuple(replace(v, present=v.present or v.name in motion) for v in features.verdicts)
    return replace(features, verdicts=verdicts)


def simplest(device: Device) -> tuple[float, float]:
    """Cold compile of the simplest scene, a point light and a square without bounces, and of its generic program: the least of
    some in turns, by a compiler that has built one before. One that has built sixty takes a tenth longer."""
    scene = {
        "version": 1,
        "camera": {"type": "perspective"},
        "integrator": {"max_bounces": 0},
        "shapes": [{"type": "quad"}],
        "lights": [{"type": "point"}],
    }
    features: Features = analyse(Scene.model_validate(scene))
    compiler = ColdCompiler(device, 1)
    try:
        found = [
            [
                compiler.seconds({**flags, "PENUMBRA_TURN": turn})
                for flags in (features.flags(), features.generic_flags())
            ]
            for turn in range(COLD_TURNS)
        ]
    finally:
        compiler.close()
    own, generic = (min(seconds) for seconds in zip(*found, strict=True))
    return own, generic


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


def expected(device: Device, rows: Sequence[Row], compiler: ColdCompiler, folder: Path) -> list[str]:
    own, generic = simplest(device)
    triangles = million(device)
    ready, sample = warm_start(folder)
    worst = min(rows, key=lambda row: row.gain)
    found = [
        (
            "own program against generic, samples a second, worst scene",
            ">= 0.98",
            f"{worst.gain:.3f} ({worst.speed.low:.3f} to {worst.speed.high:.3f}), `{worst.name}`",
        ),
        (
            "the generic program against itself, on buffers of its own, `all_effects`: where these lie",
            "",
            itself(device, folder).more(),
        ),
        (
            "cold compile, simplest scene / generic",
            "<= 0.33",
            f"{own / generic:.2f} ({own:.2f} s / {generic:.2f} s)",
        ),
        (
            "a still scene against a build that has no motion at all",
            "within 1 %",
            "the same text: no line of motion is in a still scene's program",
        ),
        (
            "a million still triangles and a still square: what motion compiled in and unused would cost",
            "",
            triangles.ratio("motion", "square").more(),
        ),
        (
            "the same: the still square itself",
            "",
            triangles.ratio("square", "alone").more(),
        ),
        (
            "the same: the square as an instance",
            "",
            triangles.ratio("instance", "square").more(),
        ),
        (
            "the same: the square moves, against the square that stands still",
            "< 10 %",
            triangles.ratio("moving", "square").more(),
        ),
        (
            "the same: it turns by 10 degrees as well",
            "< 10 %",
            triangles.ratio("turning", "square").more(),
        ),
        ("warm start: a device's process is ready", "", f"{ready:.2f} s"),
        ("from there to the first 8 samples of 64 x 64 pixels on the film", "< 0.5 s", f"{sample:.2f} s"),
        (
            "the first program that a compiler's process builds, `classic`",
            "",
            f"{compiler.first:.2f} s: LLVM starts",
        ),
    ]
    checks = [row for row in rows if row.noise is not None]
    off = max(checks, key=lambda row: abs(row.noise.deviations))  # type: ignore[union-attr]
    assert off.noise is not None
    found.append(
        (
            f"the noise table's whole against the variance that a film measures, {len(checks)} scenes",
            "within its error",
            f"furthest off: {off.noise.whole:.2f} +- {off.noise.error:.2f}, {off.noise.deviations:+.1f} standard errors, "
            f"`{off.name}`",
        )
    )
    return ["| what | wanted | measured |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in found)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", help="only these examples; then nothing is written (default: all)"
    )
    parser.add_argument(
        "--plot", action="store_true", help="measure nothing: only draw the plot again from the page"
    )
    arguments = parser.parse_args()
    if arguments.plot:
        plot(PAGE.read_text())
        return
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
    text = page(device, rows, extra, measured)
    PAGE.write_text(text)
    plot(text)


if __name__ == "__main__":
    main()
