"""What error bars cost: splitting samples into replicates, pooling their variance, and keeping both.

One render of each scene with REPLICATES independent replicates gives v(n), the variance of a replicate's mean after n
samples. R replicates of n/R samples have v(n/R) / R where one sequence has v(n).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import SumNode, Tile, merge
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene
from penumbra_service.engine.course import TILE_SIZE
from penumbra_service.film.error import EPSILON, ImageError, image_error
from penumbra_service.film.film import Film
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.preview import Preview
from penumbra_service.film.replicates import DEFAULT_REPLICATES
from penumbra_service.film.statistics import pixel_statistics
from penumbra_service.film.stop import StopRule
from penumbra_service.film.tilefile import MemoryTileStore
from penumbra_service.images.assets import FolderAssets
from penumbra_service.jobs.batches import Batches

REPLICATES: Final = 32
MOST: Final = 128
"""Samples a replicate."""
COUNTS: Final = (2, 4, 8, 16)
"""Replicates that are compared."""
BLOCKS: Final = (4, 8, 16, 32)


@dataclass(frozen=True)
class Splitting:
    """Of one scene."""

    theta: float
    """Of v(n) between 16 and 128 samples."""
    price: dict[int, float]
    """By replicates: samples to the error of 128 samples in so many replicates, over those of one sequence."""
    deviation: dict[int, float]
    """By side of a block: relative standard deviation of V pooled over it, DEFAULT_REPLICATES, the median block."""


def measure(device: Device, scene: Scene, assets: FolderAssets) -> Splitting:
    """Traces the whole picture. Raises DeviceError, AssetError."""
    tracer = Tracer(device, compile_scene(scene, assets), SamplePlan(REPLICATES))
    tile = Tile(0, 0, scene.film.width, scene.film.height)
    node = tracer.trace(tile, 0, 1)
    nodes = {1: node}
    while node.end < MOST:
        node = merge(node, tracer.trace(tile, node.end, node.sample_count))
        nodes[node.end] = node
    means = {n: _means(one) for n, one in nodes.items()}
    weights = 1 / (means[MOST].mean(axis=0) ** 2 + EPSILON)
    v = {n: float(np.mean(m.var(axis=0, ddof=1) * weights)) for n, m in means.items()}
    return Splitting(
        theta=_theta(v),
        price={r: _price(v, r) for r in COUNTS},
        deviation={side: _deviation(nodes[16], tile, side) for side in BLOCKS},
    )


def _means(node: SumNode) -> NDArray[np.float64]:
    """(replicates, height, width, 3)."""
    taken = np.maximum(node.sums["taken"], 1).astype(np.float64)[..., None]
    means: NDArray[np.float64] = node.sums["rgba"][..., :3].astype(np.float64) / taken
    return means


def _theta(v: dict[int, float]) -> float:
    n = [n for n in v if n >= 16]
    return -float(np.polyfit(np.log(n), np.log([v[i] for i in n]), 1)[0])


def _price(v: dict[int, float], replicates: int) -> float:
    """MOST samples in so many replicates over the samples of one sequence of the same error, between its points
    straight on both logarithms."""
    reached = math.log(v[MOST // replicates] / replicates)
    n = sorted(v)
    falling = [math.log(v[i]) for i in n]
    one = np.interp(-reached, [-f for f in falling], [math.log(i) for i in n])
    return float(MOST / math.exp(one))


def _groups(node: SumNode) -> list[NDArray[Any]]:
    """Renders of DEFAULT_REPLICATES each."""
    step = DEFAULT_REPLICATES
    return [node.sums[first : first + step] for first in range(0, REPLICATES, step)]


def _deviation(node: SumNode, tile: Tile, side: int) -> float:
    """Of V pooled over blocks of a side, from its spread over the groups; blocks without noise are left out."""
    pooled = np.stack([_pooled(pixel_statistics(tile, sums).variance, side) for sums in _groups(node)])
    mean = pooled.mean(axis=0)
    noisy = mean > 0
    return float(np.sqrt(np.median(pooled.var(axis=0, ddof=1)[noisy] / mean[noisy] ** 2)))


def _pooled(variance: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    plain = variance[..., :3].mean(axis=-1)
    rows = np.add.reduceat(plain, range(0, plain.shape[0], side), axis=0)
    blocks: NDArray[np.float64] = np.add.reduceat(rows, range(0, plain.shape[1], side), axis=1)
    return blocks


@dataclass(frozen=True)
class Upkeep:
    """What error bars cost beside the same samples without them, in CPU time."""

    replicates: float
    """Tracing 256 samples in DEFAULT_REPLICATES over tracing them in 1."""
    looking: float
    """Adding up two nodes and looking at the picture, at every check point of a job of 256 samples, over tracing them."""
    checks: int
    """How many those are."""


def upkeep(device: Device, scene: Scene, assets: FolderAssets, rounds: int = 5) -> Upkeep:
    """Interleaved: of replicates the median ratio, of looks the least. Tiles are those of a job."""
    window = Tile(0, 0, scene.film.width, scene.film.height)
    compiled = compile_scene(scene, assets)
    ours = DEFAULT_REPLICATES
    tracers = {r: Tracer(device, compiled, SamplePlan(r)) for r in (1, ours)}
    spent: dict[int, list[float]] = {1: [], ours: []}
    looking = []
    half = 128 // ours
    film = Film(TileGrid(window, TILE_SIZE), ours, MemoryTileStore(), "upkeep")
    film.set_barriers((half,))
    preview = Preview(window)
    for _ in range(rounds):
        for r, tracer in tracers.items():  # ours last: its nodes are looked at
            began = time.process_time()
            nodes = [tracer.trace(tile, at, 128 // r) for at in (0, 128 // r) for tile in film.tiles]
            spent[r].append(time.process_time() - began)
        for tile in film.tiles:
            film.discard(tile)
        for node in nodes:
            film.add(node)
        began = time.process_time()
        _look(film, 2 * half, preview)
        looking.append(time.process_time() - began)
    checks = check_points(ours)
    price = median(four / one for four, one in zip(spent[ours], spent[1], strict=True))
    return Upkeep(price, checks * min(looking) / min(spent[ours]), checks)


def _look(film: Film, end: int, preview: Preview) -> None:
    """As engine.canvas does it."""
    summaries = []
    for tile in film.tiles:
        pixels, summary = film.look(tile, end)
        preview.put(pixels)
        summaries.append(summary)
    image_error(summaries)


def check_points(replicates: int, samples: int = 256) -> int:
    """How often a job looks at its picture that meets its error after so many samples a pixel, of a relmse that falls as
    1 / samples."""
    batches = Batches(StopRule(replicates, relative_error=samples**-0.5))
    reason = None
    while reason is None:
        batches.open_next(None, None)
        assert batches.current is not None
        relmse = 1 / (replicates * batches.current)
        reason = batches.check(0.0, ImageError(relmse, 0.0, relmse, 0.0, 1))
    return len(batches.ends)
