"""What a render foretells at 128 samples comes true: samples to half of the error, over the example scenes."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile, aligned_ranges
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.parse import scene_from_json
from penumbra_service.film.accumulator import TileAccumulator
from penumbra_service.film.error import image_error, normal_quantile, summarize
from penumbra_service.film.predict import Point, predict
from penumbra_service.film.replicates import DEFAULT_REPLICATES
from penumbra_service.film.statistics import pixel_statistics
from penumbra_service.film.stop import next_check
from penumbra_service.images.assets import FolderAssets

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
THOROUGH = int(os.environ.get("PENUMBRA_SEEDS", "100")) >= 1000
NAMES = (
    sorted(p.stem for p in EXAMPLES.glob("*.json"))
    if THOROUGH
    else ["cornell", "depth_of_field", "glossy", "motion_blur", "textures"]
)
REPLICATES = DEFAULT_REPLICATES
TOLD_AT = 128
"""Samples a pixel."""
MOST = 2048
"""A forecast that is not true by then is wrong by more than x1.5: see `expected`."""


def small(name: str) -> dict[str, Any]:
    document = json.loads((EXAMPLES / f"{name}.json").read_text())
    film = document.setdefault("film", {})
    shape = film.get("width", 512) / film.get("height", 512)
    film |= {"width": 48, "height": max(round(48 / shape), 16)}
    film.pop("crop", None)
    film.pop("layers", None)
    document.get("sampler", {}).pop("replicates", None)
    return document


class Render:
    """A picture that gets more samples at every check point."""

    def __init__(self, device: Device, document: dict[str, Any], assets: FolderAssets) -> None:
        scene = scene_from_json(document, allow_files=True)
        plan = SamplePlan(REPLICATES)
        self._tracer = Tracer(device, compile_scene(scene, assets), plan, program="generic")
        self._tile = Tile(0, 0, scene.film.width, scene.film.height)
        self._kept = TileAccumulator(self._tile, REPLICATES)
        self._end = 0

    def check(self) -> Point:
        """The next one."""
        following = next_check(self._end)
        for first, count in aligned_ranges(self._end, following):
            self._kept.add(self._tracer.trace(self._tile, first, count))
        self._end = following
        self._kept.set_barriers((following,))
        pixels = pixel_statistics(self._tile, self._kept.fold(following))
        error = image_error([summarize(pixels)])
        upper = error.relmse * (1 + normal_quantile(0.95) * error.deviation)
        samples = following * REPLICATES
        return Point(samples, float(samples), error.relmse, upper, error.deviation)


def foretold_and_real(render: Render) -> tuple[float, float] | None:
    """Samples to half of the error that is had at TOLD_AT; None for a scene without noise."""
    points = [render.check()]
    while points[-1].samples < TOLD_AT:
        points.append(render.check())
    if not points[-1].relmse > 0:
        return None
    target = math.sqrt(points[-1].upper) / 2
    told = predict(points, target)
    assert told is not None
    expected = float(REPLICATES * next_check(math.ceil(told.samples / REPLICATES) - 1))
    point = points[-1]
    while point.upper > target**2:
        if point.samples >= MOST:
            return expected, math.inf
        point = render.check()
    return expected, float(point.samples)


def test_four_of_five_forecasts_hold_within_half_as_much_again(
    device: Device, record: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    assets = FolderAssets(tmp_path_factory.mktemp("assets"), EXAMPLES)
    found: dict[str, tuple[float, float]] = {}
    for name in NAMES:
        document = small(name)
        if document.get("sampler", {}).get("type") == "regular":
            continue
        pair = foretold_and_real(Render(device, document, assets))
        if pair is not None:
            found[name] = pair
    record("forecasts", found)
    held = [told / real for told, real in found.values()]
    assert len(held) >= len(NAMES) - 4
    assert sum(1 / 1.5 <= ratio <= 1.5 for ratio in held) >= 0.8 * len(held)
