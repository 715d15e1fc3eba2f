"""What adaptive sampling saves: processor seconds to one relative error, by sampler and strategy.

    python bench/adaptive.py [SCENE ...] [--width 160] [--target 0.03] [--json FILE]

Every variant renders with doubling sample counts until its relmse is below the target's square; the seconds at the target
are read off by a line through the last two points, log against log. Seconds are the process's own, of all threads, while
it traces: other work on the machine does not count. Those of a certified render include its pilot.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

from penumbra_kernels.allotment import even
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile, aligned_ranges
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene
from penumbra_service.film.accumulator import TileAccumulator
from penumbra_service.film.allocation import error_levels, pilot_of, theta_of
from penumbra_service.film.error import image_error, summarize
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.statistics import PixelStatistics, pixel_flags, pixel_statistics
from penumbra_service.images.assets import FolderAssets

ROOT: Final = Path(__file__).parents[1]
SCENES: Final = ("depth_of_field", "soft_shadows", "glossy", "motion_blur")
VARIANTS: Final = {
    "independent": ("independent", ""),
    "sobol": ("sobol", ""),
    "sobol, certified": ("sobol", "certified"),
    "sobol, fast": ("sobol", "fast"),
}
REPLICATES: Final = 8
PILOT: Final = 2
"""Samples a replicate."""
FIRST: Final = 2
"""Samples a replicate of the first point, and the most of the last."""
LAST: Final = 512


class Film:
    """Sums of a small picture, and what they took."""

    def __init__(self, tracer: Tracer, width: int, height: int) -> None:
        self.tracer = tracer
        self.window = Tile(0, 0, width, height)
        self.tiles = {tile: TileAccumulator(tile, REPLICATES) for tile in TileGrid(self.window)}
        self.seconds = 0.0

    def take(self, first: int, end: int, allot: Callable[[Tile], Any]) -> None:
        """All tiles' samples [first, end)."""
        for tile, sums in self.tiles.items():
            allotment = allot(tile)
            started = time.process_time()
            nodes = [self.tracer.trace(tile, *part, allotment) for part in aligned_ranges(first, end)]
            self.seconds += time.process_time() - started
            for node in nodes:
                sums.add(node)

    def pixels(self, end: int) -> list[PixelStatistics]:
        return [pixel_statistics(tile, sums.fold(end)[0]) for tile, sums in self.tiles.items()]

    def relmse(self, end: int) -> float:
        return image_error([summarize(p, pixel_flags(p)) for p in self.pixels(end)]).relmse


def scene_of(name: str, width: int, sampler: str, adaptive: bool) -> Scene:
    document = json.loads((ROOT / "examples" / f"{name}.json").read_text())
    film = document.get("film", {})
    height = width * film.get("height", 512) // film.get("width", 512)
    document["film"] = {**film, "width": width, "height": height, "layers": []}
    document["sampler"] = {"type": sampler}
    document["adaptive"] = {"strategy": "error"} if adaptive else None
    return Scene.model_validate(document)


def decide(film: Film, own: bool) -> LevelMap:
    """Has the pilot take PILOT samples a replicate."""
    variances = []
    for first, end in ((0, PILOT // 2), (PILOT // 2, PILOT)):
        film.take(first, end, lambda tile: even(tile, pilot=own))
        variances.append(sum(float(p.variance[..., :3].sum()) for p in film.pixels(end)))
    pilot = pilot_of(film.window, film.pixels(PILOT))
    levels = error_levels(film.window, pilot, theta_of(variances[0], variances[1]))
    return LevelMap(film.window, levels, 0 if own else PILOT)


def curve(device: Device, scene: Scene, mode: str, target: float) -> list[tuple[float, float, float]]:
    """(samples a pixel, seconds, relmse), until the target is reached."""
    compiled = compile_scene(scene, FolderAssets(ROOT / "examples", ROOT / "examples"), 0.0)
    tracer = Tracer(device, compiled, SamplePlan(REPLICATES))
    size = scene.film.width, scene.film.height
    film = Film(tracer, *size)
    levels = LevelMap(film.window)
    begin, before = 0, 0.0
    if mode:
        pilot = Film(tracer, *size)
        own = mode == "certified"
        levels = decide(pilot, own)
        film, begin, before = (film, 0, pilot.seconds) if own else (pilot, PILOT, 0.0)
    points = []
    samples = FIRST
    while samples <= LAST:
        end = levels.end_for(samples)
        if end > begin:
            film.take(begin, end, lambda tile: levels.allotment(tile, 0))
            begin = end
        points.append((REPLICATES * levels.mean(end), before + film.seconds, film.relmse(end)))
        if points[-1][2] <= target**2:
            break
        samples *= 2
    return points


def seconds_at(points: list[tuple[float, float, float]], target: float) -> float:
    """Seconds at which relmse is the target's square: on the line through the last two points, log against log."""
    (_, s0, e0), (_, s1, e1) = points[-2:]
    share = (math.log(target**2) - math.log(e0)) / (math.log(e1) - math.log(e0))
    return math.exp(math.log(s0) + share * (math.log(s1) - math.log(s0)))


def measure(device: Device, names: Iterable[str], width: int, target: float) -> dict[str, dict[str, float]]:
    """Seconds to the target by scene and variant; prints them as they come."""
    found: dict[str, dict[str, float]] = {}
    for name in names:
        row: dict[str, float] = {}
        for label, (sampler, mode) in VARIANTS.items():
            points = curve(device, scene_of(name, width, sampler, bool(mode)), mode, target)
            row[label] = seconds_at(points, target)
            base = row["independent"]
            print(
                f"{name:16} {label:18} {points[-1][0]:8.1f} spp  {row[label]:7.2f} s  {row[label] / base:5.2f}"
            )
        found[name] = row
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--width", type=int, default=160)
    parser.add_argument("--target", type=float, default=0.04)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = measure(Device(), options.scenes, options.width, options.target)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
