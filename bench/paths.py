"""Whole paths against other renderers: camera paths per second, and seconds to a relMSE, on the same scenes.

    python bench/paths.py [--scenes cornell mesh ...] [--renderers penumbra mitsuba_llvm/multijitter ...] [--samples 4 16 64]

Prints JSON. Two pictures of different seeds are made at each number of samples: half their mean squared difference is
the variance, and relMSE = mean(variance / (mean^2 + 0.01)), the mean over all pictures of all renderers. All of them are
unbiased (against_mitsuba.py tests that), so no reference picture is needed. Seconds to a relMSE are interpolated on
log-log axes, or extrapolated from the two last points. Scenes are built and programs compiled before the clock starts.
From 64 samples on, none are added once relMSE is within five times the least target.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from clock import clock, cores
from numpy.typing import NDArray
from peer import PEERS, Peer
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_service.film.replicates import DEFAULT_REPLICATES
from scenes import SCENES, SIZE, UnsupportedError, build

Array = NDArray[np.float64]
OURS = "penumbra_1"
EPSILON = 0.01
TARGETS = (1e-2, 1e-3)
ENOUGH = 64
NEAR = 5.0
SEEDS = (1, 2)
LLVM = ("libLLVM-19.so", "libLLVM.so.19.1")
RENDERERS = (
    "penumbra",
    "penumbra_1",
    "mitsuba_scalar/independent",
    "mitsuba_scalar/multijitter",
    "mitsuba_llvm/independent",
    "mitsuba_llvm/multijitter",
)
"""`penumbra` renders as the service does: some replicates, whose spread is the error bar. `penumbra_1` has one: no error bar,
but one sequence over all samples, as the others have."""


class Renderer(Protocol):
    """A scene in a renderer, loaded."""

    def prepare(self, samples: int) -> None:
        """Whatever is done once: programs, buffers."""

    def render(self, samples: int, seed: int) -> Array:
        """(height, width, 3)."""

    def seconds(self) -> float:
        """A clock of the rendering."""

    def close(self) -> None:
        """Whatever is left to end."""


class InProcess:
    """A renderer that shares this process and its clock."""

    def seconds(self) -> float:
        return clock()

    def close(self) -> None:
        """Nothing."""


class Penumbra(InProcess):
    """This renderer, without the service around it."""

    def __init__(self, name: str, sampler: str, replicates: int) -> None:
        self._device = Device()
        self._replicates = replicates
        self._compiled = {seed: compile_scene(*build(name, sampler, seed)) for seed in SEEDS}
        self._tracers: dict[tuple[int, int], Tracer] = {}

    def prepare(self, samples: int) -> None:
        replicates = min(self._replicates, samples)
        for seed, compiled in self._compiled.items():
            tracer = Tracer(self._device, compiled, SamplePlan(replicates, samples // replicates))
            tracer.trace(Tile(0, 0, 8, 8), 0, 1)
            self._tracers[samples, seed] = tracer

    def render(self, samples: int, seed: int) -> Array:
        tracer = self._tracers[samples, seed]
        sums = tracer.trace(Tile(0, 0, SIZE, SIZE), 0, samples // tracer.plan.replicates).sums
        return np.asarray((sums["rgba"][..., :3] / sums["taken"][..., None]).mean(axis=0, dtype=np.float64))


def find_llvm() -> None:
    """Mitsuba's llvm variants ask for a library by this variable; Debian's libllvm19 is one that works."""
    for name in LLVM:
        path = Path("/usr/lib/x86_64-linux-gnu") / name
        if path.exists():
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(path))


class Mitsuba(InProcess):
    """Mitsuba's path integrator with roulette off, as in our scenes."""

    def __init__(self, name: str, variant: str, sampler: str) -> None:
        find_llvm()
        import mitsuba as mi

        mi.set_variant({"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb"}[variant])
        import drjit as dr
        from mitsuba_scene import to_mitsuba

        dr.set_thread_count(cores())
        scene, held = build(name)
        self._mi, self._scene = mi, mi.load_dict(to_mitsuba(scene, sampler, held))

    def prepare(self, samples: int) -> None:
        self.render(1, 999)

    def render(self, samples: int, seed: int) -> Array:
        return np.array(self._mi.render(self._scene, spp=samples, seed=seed), np.float64)


def renderer(name: str, which: str) -> Renderer:
    """`penumbra[/sampler]`, `penumbra_1[/sampler]`, `mitsuba_<variant>/<sampler>`, `cycles` or `luxcore` on a scene. Raises
    ImportError where a package is missing, UnsupportedError where the scene has what the renderer lacks."""
    program, _, sampler = which.partition("/")
    if program in PEERS:
        return Peer(name, program)
    if program.startswith("penumbra"):
        return Penumbra(name, sampler or "sobol", 1 if program == "penumbra_1" else DEFAULT_REPLICATES)
    if importlib.util.find_spec("mitsuba") is None:
        raise ImportError("mitsuba is not installed")
    return Mitsuba(name, program.removeprefix("mitsuba_"), sampler)


def measure(loaded: Renderer, ladder: list[int]) -> list[dict[str, Any]]:
    """Seconds a picture and the two pictures at each number of samples."""
    points = []
    for samples in ladder:
        loaded.prepare(samples)
        started = loaded.seconds()
        pictures = [loaded.render(samples, seed) for seed in SEEDS]
        seconds = (loaded.seconds() - started) / len(SEEDS)
        points.append({"samples": samples, "seconds": seconds, "pictures": pictures})
        if samples >= ENOUGH and relmse(pictures, np.mean(pictures, axis=0)) < NEAR * min(TARGETS):
            break
    loaded.close()
    return points


def relmse(pictures: list[Array], mean: Array) -> float:
    """Of one picture, from two of the same expectation and variance."""
    a, b = pictures
    return float(np.mean(0.5 * (a - b) ** 2 / (mean**2 + EPSILON)))


def seconds_to(points: list[dict[str, Any]], target: float) -> float:
    """Where the line through the measured (seconds, relMSE) meets the target; from one point on, relMSE falls as 1/seconds."""
    if len(points) == 1:
        return float(points[0]["seconds"] * points[0]["relmse"] / target)
    x = np.log([p["relmse"] for p in points])
    y = np.log([p["seconds"] for p in points])
    k = int(np.clip(np.searchsorted(-x, -np.log(target)), 1, len(x) - 1))
    slope = (y[k] - y[k - 1]) / (x[k] - x[k - 1]) if x[k] < x[k - 1] else -1.0
    return float(np.exp(y[k] + slope * (np.log(target) - x[k])))


def agreement(pictures: list[Array], ours: list[Array]) -> dict[str, float]:
    """Ratio of image means to Penumbra's, and rms difference of 8 x 8 blocks over what noise explains: 1 where both agree."""
    a, b = np.stack(pictures), np.stack(ours)
    tiles = [x.reshape(2, SIZE // 8, 8, SIZE // 8, 8, 3).mean(axis=(2, 4, 5)) for x in (a, b)]
    noise = sum(float(np.mean((t[0] - t[1]) ** 2)) / 4 for t in tiles)
    apart = float(np.mean((tiles[0].mean(axis=0) - tiles[1].mean(axis=0)) ** 2))
    return {
        "mean_ratio": round(float(a.mean() / b.mean()), 4),
        "rms_z": round(float(np.sqrt(apart / noise)), 2),
    }


def finish(points: list[dict[str, Any]], mean: Array) -> dict[str, Any]:
    """What is reported of one renderer on one scene."""
    for point in points:
        point["relmse"] = relmse(point.pop("pictures"), mean)
    last = points[-1]
    result: dict[str, Any] = {
        "mpaths_per_second": round(SIZE * SIZE * last["samples"] / last["seconds"] / 1e6, 4)
    }
    for target in TARGETS:
        result[f"seconds_to_{target:g}"] = float(f"{seconds_to(points, target):.3g}")
    result["points"] = [{k: float(f"{v:.3g}") if k != "samples" else v for k, v in p.items()} for p in points]
    return result


def compare(name: str, which: list[str], ladder: list[int]) -> dict[str, Any]:
    """One scene on every renderer that has what it needs; the others by name, with the reason."""
    measured: dict[str, list[dict[str, Any]]] = {}
    left_out: dict[str, str] = {}
    for one in which:
        rungs = ladder[:2] if one.startswith("mitsuba_scalar") else ladder  # it is slow
        try:
            measured[one] = measure(renderer(name, one), rungs)
        except (ImportError, UnsupportedError) as error:
            left_out[one] = str(error).splitlines()[0]
    mean = np.mean([p for points in measured.values() for p in points[-1]["pictures"]], axis=0)
    last = {one: points[-1]["pictures"] for one, points in measured.items()}
    result: dict[str, Any] = {one: finish(points, mean) for one, points in measured.items()}
    for one in last.keys() - {OURS} if OURS in last else ():
        result[one] |= agreement(last[one], last[OURS])
    return result | ({"left_out": left_out} if left_out else {})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--renderers", nargs="+", default=list(RENDERERS))
    parser.add_argument("--samples", type=int, nargs="+", default=[4, 16, 64])
    options = parser.parse_args()
    print(json.dumps({name: compare(name, options.renderers, options.samples) for name in options.scenes}))


if __name__ == "__main__":
    main()
