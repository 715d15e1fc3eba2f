"""`make lights`: how light_selection fares in rooms with few, 200 and 10,000 lamps; writes docs/lights.md.

Each way renders the same scene with the same samples. The error is relMSE, the mean over pixels of variance / (mean^2 + 0.01)
with the means of the tree's picture; seconds are of tracing, and those to relMSE 1e-3 go as error over samples. Metres.
"""

from __future__ import annotations

import argparse
import datetime
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.features import light_selection
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "lights.md"
TARGET: Final = 1e-3
REPLICATES: Final = 8
WAYS: Final = ("uniform", "power", "tree")
SKY: Final = {"environment": {"type": "constant", "radiance": 0.3}}
SUN: Final = {"lights": [{"type": "directional", "direction": [0.3, -1, 0.2], "irradiance": 1.0}]}
BESIDE: Final[dict[str, tuple[dict[str, Any], tuple[int, ...]]]] = {
    "nothing": ({}, (2, 3, 4, 8)),
    "a sky": (SKY, (1, 2, 3, 4, 5, 6, 8)),
    "a sun": (SUN, (1, 2, 3, 4)),
    "a sun and a sky": (SUN | SKY, (1, 2, 4)),
}
"""What else there is, and beside how many lamps. A room with something beside its lamps has no ceiling."""
HALVES: Final = (3.0, 10.0)
ROOMS: Final = 6
"""Of each size, whose lamps are in other places."""
FEW_SAMPLES: Final = 128


@dataclass(frozen=True)
class Result:
    compile_seconds: float
    seconds: float
    """Of tracing."""
    mean: NDArray[np.float64]
    variance: NDArray[np.float64]

    def relmse(self, truth: NDArray[np.float64]) -> float:
        return float((self.variance / (truth**2 + 0.01)).mean())


def room(lamps: int, half: float, way: str, side: int, beside: str = "nothing", seed: int = 1) -> Scene:
    """A diffuse room, 2 `half` square and 4 high, a dozen balls on its floor, and lamps of 10 cm above them that shine
    down, by up to 1:30 in power. beside: a key of BESIDE; seed: of all places."""
    rng = np.random.default_rng(seed)
    walls = [
        ([-half, 0, half], [2 * half, 0, 0], [0, 0, -2 * half]),
        ([-half, 0, -half], [2 * half, 0, 0], [0, 4, 0]),
        ([-half, 0, half], [0, 0, -2 * half], [0, 4, 0]),
        ([half, 0, -half], [0, 0, 2 * half], [0, 4, 0]),
    ]
    if beside == "nothing":
        walls.append(([-half, 4, -half], [2 * half, 0, 0], [0, 0, 2 * half]))
    shapes: list[dict[str, Any]] = [
        {"type": "quad", "origin": o, "u": u, "v": v, "material": "wall"} for o, u, v in walls
    ]
    for x, z in rng.uniform(-0.8 * half, 0.8 * half, (12, 2)).tolist():
        shapes.append({"type": "sphere", "center": [x, 0.8, z], "radius": 0.8, "material": "wall"})
    for x, y, z in rng.uniform(
        [-0.95 * half, 1.8, -0.95 * half], [0.95 * half, 3.8, 0.95 * half], (lamps, 3)
    ).tolist():
        glow = {"radiance": float(10.0 ** rng.uniform(1.0, 2.5))}
        shapes.append(
            {
                "type": "quad",
                "origin": [x, y, z],
                "u": [0.1, 0, 0],
                "v": [0, 0, 0.1],
                "material": "wall",
                "emission": glow,
            }
        )
    scene: dict[str, Any] = {
        "version": 1,
        "camera": {
            "type": "perspective",
            "fov": 60,
            "transform": {"look_at": {"origin": [0, 2, 0.9 * half], "target": [0, 1, 0]}},
        },
        "film": {"width": side, "height": side},
        "materials": {"wall": {"type": "diffuse", "base_color": 0.6}},
        "shapes": shapes,
        "integrator": {"max_bounces": 4, "light_selection": way},
        **BESIDE[beside][0],
    }
    return Scene.model_validate(scene)


def measure(device: Device, scene: Scene, samples: int) -> Result:
    """Renders `samples` a pixel, a power of two of them in each replicate."""
    started = time.perf_counter()
    compiled = compile_scene(scene, NoAssets())
    compile_seconds = time.perf_counter() - started
    tracer = Tracer(device, compiled, SamplePlan(REPLICATES, samples // REPLICATES))
    tracer.trace(Tile(0, 0, 8, 8), 0, 1)
    started = time.perf_counter()
    mean, variance = picture(tracer, scene, samples)
    return Result(compile_seconds, time.perf_counter() - started, mean, variance)


def picture(tracer: Tracer, scene: Scene, samples: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(h, w, 3) means, and their variances."""
    sums = tracer.trace(Tile(0, 0, scene.film.width, scene.film.height), 0, samples // REPLICATES).sums
    means = sums["rgba"][..., :3].astype(np.float64) / sums["taken"][..., None]
    mean = means.mean(axis=0)
    return mean, ((means - mean) ** 2).sum(axis=0) / (REPLICATES * (REPLICATES - 1))


def compare(device: Device, lamps: int, half: float, side: int, samples: int) -> dict[str, Result]:
    """Every way of choosing in one room."""
    return {way: measure(device, room(lamps, half, way, side), samples) for way in WAYS}


def tree_over_power(device: Device, lamps: int, half: float, beside: str) -> tuple[float, float]:
    """(time, variance) of the tree's pictures over those by power, at equal samples: CPU seconds of all rooms together, and
    the geometric mean over rooms, whose few bright pixels make much of a single one's."""
    seconds = {"power": 0.0, "tree": 0.0}
    logs = []
    for seed in range(ROOMS):
        found = {}
        for way in ("power", "tree") if seed % 2 else ("tree", "power"):
            scene = room(lamps, half, way, 64, beside, seed)
            plan = SamplePlan(REPLICATES, FEW_SAMPLES // REPLICATES)
            tracer = Tracer(device, compile_scene(scene, NoAssets()), plan)
            tracer.trace(Tile(0, 0, 8, 8), 0, 1)
            started = time.process_time()
            mean, variance = picture(tracer, scene, FEW_SAMPLES)
            seconds[way] += time.process_time() - started
            found[way] = Result(0.0, 0.0, mean, variance)
        truth = found["tree"].mean
        logs.append(np.log(found["tree"].relmse(truth) / found["power"].relmse(truth)))
    return seconds["tree"] / seconds["power"], float(np.exp(np.mean(logs)))


def seconds_to_target(result: Result, truth: NDArray[np.float64]) -> float:
    return result.seconds * result.relmse(truth) / TARGET


def large_table(results: dict[str, Result]) -> list[str]:
    """A row a way."""
    truth = results["tree"].mean
    rows = [
        "| `light_selection` | compile, s | trace, s | relMSE | seconds to relMSE 1e-3 |",
        "|---|---|---|---|---|",
    ]
    for way, result in results.items():
        rows.append(
            f"| `{way}` | {result.compile_seconds:.2f} | {result.seconds:.2f} | {result.relmse(truth):.2e} "
            f"| {seconds_to_target(result, truth):.1f} |"
        )
    return rows


def small_table(device: Device) -> list[str]:
    """A row for each number of lamps and what is beside them: the tree against power, and what `auto` takes."""
    sizes = [f"{2 * half:g} m" for half in HALVES]
    rows = [
        "| lamps | beside | "
        + " | ".join(f"{size}: time | variance | time to equal error" for size in sizes)
        + " | `auto` |",
        "|---" * (3 + 3 * len(HALVES)) + "|",
    ]
    for beside, (_, counts) in BESIDE.items():
        for lamps in counts:
            cells = []
            for half in HALVES:
                slower, quieter = tree_over_power(device, lamps, half, beside)
                cells += [f"{slower:.2f}", f"{quieter:.2f}", f"{slower * quieter:.2f}"]
            auto = light_selection(room(lamps, HALVES[0], "auto", 8, beside))
            rows.append(f"| {lamps} | {beside} | {' | '.join(cells)} | `{auto}` |")
    return rows


def page(device: Device) -> str:
    """docs/lights.md."""
    info = device.info
    compile_scene(room(5000, 40.0, "power", 8), NoAssets())  # numba's own compilation is not what is measured
    rooms = [
        ("A room with 200 lamps, 128 x 128, 64 samples a pixel", compare(device, 200, 10.0, 128, 64)),
        ("A hall with 10,000 lamps, 96 x 96, 64 samples a pixel", compare(device, 10_000, 40.0, 96, 64)),
    ]
    parts = [
        "# Lights, measured",
        "What [`light_selection`](scene.md#which-lights-a-hit-asks) costs and gives, on "
        f"{info.name} ({info.compute_units} cores, {info.target or info.platform}), "
        f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}. Diffuse rooms with four bounces and one shadow ray a hit; lamps "
        "are quads of 10 cm, at random places under the ceiling, by up to 1:30 in power. relMSE is the mean of variance / "
        "(mean^2 + 0.01) over pixels. `make lights` makes this page.",
    ]
    for title, results in rooms:
        parts += [f"## {title}", "\n".join(large_table(results))]
    parts += [
        "## Few lamps",
        f"{ROOMS} such rooms of 20 m and as many of 6 m, 64 x 64, {FEW_SAMPLES} samples a pixel: the tree's numbers over those "
        "by `power`, times in processor seconds, variances as geometric means over the rooms. A sky is constant, a sun "
        "directional; beside them a room has no ceiling. `auto` takes the tree where it gained in rooms of either "
        "size, and beside a sky alone from five lamps on, where what it gains in small rooms is far more than what it loses "
        "in large ones.",
        "\n".join(small_table(device)),
    ]
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Writes the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    PAGE.write_text(page(Device()))


if __name__ == "__main__":
    main()
