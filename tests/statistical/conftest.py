"""Many renders of small scenes whose true pixels are known in closed form, and what the film says of each render.

PENUMBRA_SEEDS says how many seeds (100; `make test-statistics` takes 1,000). One tracer renders them all: only the
seed of its parameters changes. What is measured goes to the file that PENUMBRA_STATISTICS names, for docs/coverage.md.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.parse import scene_from_json
from penumbra_service.film import flags
from penumbra_service.film.replicates import DEFAULT_REPLICATES
from penumbra_service.film.statistics import PixelStatistics, pixel_flags, pixel_statistics, t_quantile

SIDE: Final = 32
REPLICATES: Final = DEFAULT_REPLICATES
SEEDS: Final = int(os.environ.get("PENUMBRA_SEEDS", "100"))
CONFIDENCES: Final = (0.5, 0.8, 0.9, 0.95, 0.99)
TILE: Final = Tile(0, 0, SIDE, SIDE)

Polygon = list[NDArray[np.float64]]


# ---- scenes with known means: (document, truth (SIDE, SIDE))
def _looking_down(**more: Any) -> dict[str, Any]:
    """An orthographic camera over the square [-1, 1]^2 of the floor; x to the right, z down the picture."""
    look = {"origin": [0, 10, 0], "target": [0, 0, 0], "up": [0, 0, -1]}
    return {
        "version": 1,
        "camera": {"type": "orthographic", "height": 2, "transform": {"look_at": look}},
        "film": {"width": SIDE, "height": SIDE},
        "integrator": {"max_bounces": 0},
        **more,
    }


def _corners(pixel: int) -> tuple[float, float]:
    return -1 + 2 * pixel / SIDE, -1 + 2 * (pixel + 1) / SIDE


def _clip(polygon: Polygon, normal: NDArray[np.float64], offset: float) -> Polygon:
    """The part where normal . p >= offset (Sutherland and Hodgman 1974, one plane)."""
    kept: Polygon = []
    for a, b in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        da, db = float(normal @ a) - offset, float(normal @ b) - offset
        if da >= 0:
            kept.append(a)
        if (da >= 0) != (db >= 0):
            kept.append(a + (b - a) * (da / (da - db)))
    return kept


def _area(polygon: Polygon) -> float:
    points = zip(polygon, [*polygon[1:], *polygon[:1]], strict=True)
    return abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in points)) / 2 if polygon else 0.0


def edge() -> tuple[dict[str, Any], NDArray[np.float64]]:
    """A glowing parallelogram before black: a pixel's value is the share of it that the parallelogram covers."""
    origin, u, v = np.array([-0.7, -0.45]), np.array([1.1, 0.27]), np.array([-0.19, 0.83])
    quad = {"type": "quad", "origin": [origin[0], 0, origin[1]], "u": [u[0], 0, u[1]], "v": [v[0], 0, v[1]],
            "emission": {"radiance": 1, "two_sided": True}}  # fmt: skip
    corners = [origin, origin + u, origin + u + v, origin + v]
    truth = np.zeros((SIDE, SIDE))
    for y in range(SIDE):
        for x in range(SIDE):
            inside: Polygon = corners
            for axis, place in ((0, x), (1, y)):
                low, high = _corners(place)
                normal = np.eye(2)[axis]
                inside = _clip(_clip(inside, normal, low), -normal, -high) if inside else inside
            truth[y, x] = _area(inside) * (SIDE / 2) ** 2
    return _looking_down(shapes=[quad]), truth


LAMP: Final[Polygon] = [
    np.array(p, float) for p in ((1.6, 1.5, -0.5), (2.6, 1.5, -0.5), (2.6, 1.5, 0.7), (1.6, 1.5, 0.7))
]
WALL_X, WALL_TOP = 1.3, 0.55
RADIANCE, ALBEDO = 20.0, 0.5


def _irradiance(point: NDArray[np.float64], lamp: Polygon) -> float:
    """Of a floor point under a polygon of radiance 1 (Lambert 1760; Arvo 1994, eq. 8)."""
    if len(lamp) < 3:
        return 0.0
    units = [(corner - point) / np.linalg.norm(corner - point) for corner in lamp]
    total = 0.0
    for a, b in zip(units, [*units[1:], *units[:1]], strict=True):
        cross = np.cross(a, b)
        length = float(np.linalg.norm(cross))
        total += math.atan2(length, float(a @ b)) * float(cross[1]) / length if length > 0 else 0.0
    return abs(total) / 2


def _floor(wall: bool) -> NDArray[np.float64]:
    """Radiance of each pixel of the floor: 6 x 6 Gauss-Legendre points of the closed form."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    truth = np.zeros((SIDE, SIDE))
    for y in range(SIDE):
        for x in range(SIDE):
            for i, wi in zip(nodes, weights, strict=True):
                for j, wj in zip(nodes, weights, strict=True):
                    point = np.array([-1 + (2 * x + 1 + i) / SIDE, 0.0, -1 + (2 * y + 1 + j) / SIDE])
                    seen = LAMP
                    if wall:  # above the plane through the point and the wall's upper edge
                        normal = np.array([-WALL_TOP, WALL_X - point[0], 0.0])
                        seen = _clip(LAMP, normal, float(normal @ point))
                    truth[y, x] += wi * wj / 4 * _irradiance(point, seen)
    return truth * RADIANCE * ALBEDO / math.pi


def _lit_floor(*more: dict[str, Any]) -> dict[str, Any]:
    floor = {"type": "quad", "origin": [-3, 0, 3], "u": [9, 0, 0], "v": [0, 0, -6], "material": "gray"}
    lamp = {"type": "quad", "origin": [1.6, 1.5, -0.5], "u": [1, 0, 0], "v": [0, 0, 1.2],
            "emission": {"radiance": RADIANCE}}  # fmt: skip
    gray = {"gray": {"type": "diffuse", "base_color": ALBEDO}}
    return _looking_down(materials=gray, shapes=[floor, lamp, *more])


def lamp() -> tuple[dict[str, Any], NDArray[np.float64]]:
    """A floor beside a lamp, nothing between: smooth."""
    return _lit_floor(), _floor(wall=False)


def penumbra() -> tuple[dict[str, Any], NDArray[np.float64]]:
    """The same behind a wall: a soft shadow."""
    wall = {
        "type": "quad",
        "origin": [WALL_X, 0, -60],
        "u": [0, WALL_TOP, 0],
        "v": [0, 0, 120],
        "material": "gray",
    }
    return _lit_floor(wall), _floor(wall=True)


def fireflies() -> tuple[dict[str, Any], NDArray[np.float64]]:
    """A glowing ground with a spark of 1/1000 of each pixel, a thousand times as bright: what nobody can promise."""
    share, bright = 1e-3, 1000.0
    side = 2 / SIDE * math.sqrt(share)
    places = -1 + 2 / SIDE * (np.arange(SIDE) + 0.37)
    ground = {"type": "quad", "origin": [-2, -1, -2], "u": [4, 0, 0], "v": [0, 0, 4],
              "emission": {"radiance": 1, "two_sided": True}}  # fmt: skip
    sparks = [
        {"type": "quad", "origin": [x, 0, z], "u": [side, 0, 0], "v": [0, 0, side],
         "emission": {"radiance": bright, "two_sided": True}}
        for x in places for z in places
    ]  # fmt: skip
    return _looking_down(shapes=[ground, *sparks]), np.full((SIDE, SIDE), 1 - share + share * bright)


SCENES: Final = {f.__name__: f for f in (edge, lamp, penumbra, fireflies)}


# ---- many renders of one scene
@dataclass
class Study:
    """Sums over seeds; pixels are those whose true variance is not 0."""

    truth: NDArray[np.float64]
    seeds: int = 0
    mean: NDArray[np.float64] = field(default_factory=lambda: np.zeros((SIDE, SIDE)))
    square: NDArray[np.float64] = field(default_factory=lambda: np.zeros((SIDE, SIDE)))
    claimed: NDArray[np.float64] = field(default_factory=lambda: np.zeros((SIDE, SIDE)))
    error: NDArray[np.float64] = field(default_factory=lambda: np.zeros((SIDE, SIDE)))
    """Of (m - truth)^2."""
    covered: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(CONFIDENCES), np.int64))
    trusted: int = 0
    """Pixels without a flag, over all seeds."""
    covered_flagged: int = 0
    """Of the flagged ones, at 95 %."""
    flagged: int = 0

    def add(self, pixels: PixelStatistics, pooled: NDArray[np.bool_]) -> None:
        """One render; `pooled`: pixels that count."""
        m, v = pixels.mean[..., 0], pixels.variance[..., 0]
        known = np.isfinite(v)
        self.seeds += 1
        self.mean += m
        self.square += m * m
        self.claimed += np.where(known, v, 0.0)
        self.error += (m - self.truth) ** 2
        flagged = (pixel_flags(pixels) & flags.UNTRUSTED) != 0
        off = np.abs(m - self.truth)
        degrees = np.maximum(pixels.replicates - 1, 1)
        trusted = pooled & ~flagged & known
        for i, confidence in enumerate(CONFIDENCES):
            quantiles = np.array([0.0, *(t_quantile(confidence, d) for d in range(1, REPLICATES))])
            inside = off <= quantiles[degrees] * np.sqrt(v)
            self.covered[i] += int(np.count_nonzero(inside & trusted))
            if confidence == 0.95:
                self.covered_flagged += int(np.count_nonzero(inside & pooled & flagged & known))
        self.trusted += int(np.count_nonzero(trusted))
        self.flagged += int(np.count_nonzero(pooled & flagged))

    @property
    def real(self) -> NDArray[np.float64]:
        """Variance of the pixels' means over seeds."""
        return (self.square - self.mean**2 / self.seeds) / (self.seeds - 1)

    def ratio(self, pooled: NDArray[np.bool_]) -> float:
        """Estimated over real variance, pooled."""
        return float((self.claimed[pooled].sum() / self.seeds) / self.real[pooled].sum())

    @property
    def coverage(self) -> list[float]:
        return [int(n) / max(self.trusted, 1) for n in self.covered]

    @property
    def flagged_share(self) -> float:
        return self.flagged / max(self.flagged + self.trusted, 1)


@dataclass(frozen=True)
class Lab:
    """A scene with a sampler on a device, ready for any seed."""

    tracer: Tracer
    truth: NDArray[np.float64]
    pooled: NDArray[np.bool_]
    """Pixels whose samples differ: on the rest every render is right, and there is nothing to estimate."""

    def render(self, seed: int, samples: int) -> PixelStatistics:
        """The film's account of one render."""
        self.tracer.reseed(seed)
        node = self.tracer.trace(TILE, 0, samples // REPLICATES)
        return pixel_statistics(TILE, node.sums)

    def study(self, samples: int, seeds: int = SEEDS, truth: NDArray[np.float64] | None = None) -> Study:
        """Renders of `seeds` seeds."""
        study = Study(self.truth if truth is None else truth)
        for seed in range(seeds):
            study.add(self.render(seed, samples), self.pooled)
        return study


Open = Callable[..., Lab]


@pytest.fixture(scope="session")
def lab(device: Device) -> Open:
    """lab(scene, sampler, strata=planned samples a replicate) -> Lab."""
    known: dict[str, tuple[dict[str, Any], NDArray[np.float64]]] = {}

    def open_lab(name: str, sampler: str, strata: int = 0) -> Lab:
        if name not in known:
            known[name] = SCENES[name]()
        document, truth = known[name]
        scene = scene_from_json({**document, "sampler": {"type": sampler}})
        compiled = compile_scene(scene, NoAssets())
        program = os.environ.get("PENUMBRA_STATISTICS_PROGRAM", "generic")
        tracer = Tracer(device, compiled, SamplePlan(REPLICATES, strata), program=program)
        pooled = (truth > 1e-9) & (truth < 1 - 1e-9) if name == "edge" else truth > 1e-9
        return Lab(tracer, truth, pooled)

    return open_lab


Record = Callable[[str, Any], None]


@pytest.fixture(scope="session")
def record() -> Iterator[Record]:
    """record(key, value): writes it down for the page, where one is asked for."""
    found: dict[str, Any] = {}
    yield found.__setitem__
    path = os.environ.get("PENUMBRA_STATISTICS")
    if path:
        file = Path(path)
        before = json.loads(file.read_text()) if file.exists() else {}
        file.write_text(json.dumps({**before, **found}, indent=1, sort_keys=True) + "\n")


@pytest.fixture(scope="session")
def seeds() -> int:
    """How many."""
    return SEEDS
