"""Whole paths against Mitsuba 3: camera paths per second, and seconds to a relMSE, on the same scenes.

    python bench/paths.py [--scenes cornell mesh ...] [--renderers penumbra mitsuba_llvm/multijitter ...] [--samples 4 16 64]

Prints JSON. Two pictures of different seeds are made at each number of samples: half their mean squared difference is
the variance, and relMSE = mean(variance / (mean^2 + 0.01)), the mean over all pictures of all renderers. All of them are
unbiased (against_mitsuba.py tests that), so no reference picture is needed. Seconds to a relMSE are interpolated on
log-log axes, or extrapolated from the two last points. Scenes are built and programs compiled before the clock starts.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from clock import clock, cores
from numpy.typing import NDArray
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from scenes import SCENES, SIZE, build

Array = NDArray[np.float64]
Render = Callable[[int, int], Array]
"""(samples, seed) -> (height, width, 3)."""
REPLICATES = 8
EPSILON = 0.01
TARGETS = (1e-2, 1e-3)
LLVM = ("libLLVM-19.so", "libLLVM.so.19.1")
RENDERERS = (
    "penumbra",
    "mitsuba_scalar/independent",
    "mitsuba_scalar/multijitter",
    "mitsuba_llvm/independent",
    "mitsuba_llvm/multijitter",
)


def penumbra(name: str, sampler: str) -> Render:
    """As the service renders: 8 replicates, whose spread is the error bar."""
    device = Device()
    tracers: dict[tuple[int, int], Tracer] = {}
    compiled = {}

    def render(samples: int, seed: int) -> Array:
        replicates = min(REPLICATES, samples)
        count = samples // replicates
        if seed not in compiled:
            compiled[seed] = compile_scene(*build(name, sampler, seed))
        key = (count, seed)
        if key not in tracers:
            tracers[key] = Tracer(device, compiled[seed], SamplePlan(replicates, count))
        sums = tracers[key].trace(Tile(0, 0, SIZE, SIZE), 0, count).sums
        return np.asarray((sums["rgba"][..., :3] / sums["taken"][..., None]).mean(axis=0, dtype=np.float64))

    return render


def find_llvm() -> None:
    """Mitsuba's llvm variants ask for a library by this variable; Debian's libllvm19 is one that works."""
    for name in LLVM:
        path = Path("/usr/lib/x86_64-linux-gnu") / name
        if path.exists():
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(path))


def mitsuba(name: str, variant: str, sampler: str) -> Render:
    """Mitsuba's path integrator with roulette off, as in our scenes."""
    find_llvm()
    import mitsuba as mi

    mi.set_variant({"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb"}[variant])
    import drjit as dr
    from mitsuba_scene import to_mitsuba

    dr.set_thread_count(cores())
    scene, held = build(name)
    loaded = mi.load_dict(to_mitsuba(scene, sampler, held))

    def render(samples: int, seed: int) -> Array:
        return np.array(mi.render(loaded, spp=samples, seed=seed), np.float64)

    return render


def renderer(name: str, which: str) -> Render:
    """`penumbra`, `penumbra/<sampler>` or `mitsuba_<variant>/<sampler>` on a scene."""
    program, _, sampler = which.partition("/")
    if program == "penumbra":
        return penumbra(name, sampler or "sobol")
    return mitsuba(name, program.removeprefix("mitsuba_"), sampler)


def measure(render: Render, ladder: list[int]) -> list[dict[str, Any]]:
    """Seconds a picture and the two pictures at each number of samples; each is rendered once before."""
    points = []
    for samples in ladder:
        render(samples, 1), render(samples, 2)
        started = clock()
        pictures = [render(samples, seed) for seed in (1, 2)]
        points.append({"samples": samples, "seconds": (clock() - started) / 2, "pictures": pictures})
    return points


def seconds_to(points: list[dict[str, Any]], target: float) -> float:
    """Where the line through the measured (seconds, relMSE) meets the target."""
    x = np.log([p["relmse"] for p in points])
    y = np.log([p["seconds"] for p in points])
    k = int(np.clip(np.searchsorted(-x, -np.log(target)), 1, len(x) - 1))
    slope = (y[k] - y[k - 1]) / (x[k] - x[k - 1]) if x[k] < x[k - 1] else -1.0
    return float(np.exp(y[k] + slope * (np.log(target) - x[k])))


def finish(points: list[dict[str, Any]], mean: Array) -> dict[str, Any]:
    """What is reported of one renderer on one scene."""
    for point in points:
        a, b = point.pop("pictures")
        point["relmse"] = float(np.mean(0.5 * (a - b) ** 2 / (mean**2 + EPSILON)))
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
        if one.startswith("mitsuba") and importlib.util.find_spec("mitsuba") is None:
            left_out[one] = "mitsuba is not installed"
            continue
        try:
            measured[one] = measure(renderer(name, one), ladder)
        except (ImportError, ValueError) as error:
            left_out[one] = str(error).splitlines()[0]
    mean = np.mean([p for points in measured.values() for p in points[-1]["pictures"]], axis=0)
    result: dict[str, Any] = {one: finish(points, mean) for one, points in measured.items()}
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
