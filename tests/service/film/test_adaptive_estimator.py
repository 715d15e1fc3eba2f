"""A certified adaptive picture is unbiased, and its variance channel is the variance of its means."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.allotment import even
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile, aligned_ranges
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene
from penumbra_service.film.accumulator import TileAccumulator
from penumbra_service.film.allocation import error_levels, pilot_of
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.statistics import PixelStatistics, pixel_statistics

from tests.kernels.trace.test_estimator import soft_shadow

SEEDS = 100
SIDE = 32
WINDOW = Tile(0, 0, SIDE, SIDE)
REPLICATES = 8
PILOT = 2
SAMPLES = 4
"""A replicate, on average over the picture."""
SIGMAS = 6.0
"""Two-sided, 1e-6 over all 64 blocks and channels and the picture as a whole."""


@dataclass(frozen=True)
class Pictures:
    """Of all seeds: means (seeds, height, width, 3), their variances as claimed, and the samples of each pixel."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    taken: NDArray[np.uint64]

    @property
    def blocks(self) -> NDArray[np.float64]:
        """Means over 8 x 8 blocks, (seeds, ...)."""
        return self.mean.reshape(SEEDS, SIDE // 8, 8, SIDE // 8, 8, 3).mean(axis=(2, 4))


def tracer_of(device: Device, seed: int, adaptive: bool) -> Tracer:
    section = {"strategy": "error"} if adaptive else None
    sections = {"sampler": {"type": "sobol", "seed": seed}, "adaptive": section}
    scene = Scene.model_validate({"version": 1, **soft_shadow("sobol"), **sections})
    return Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(REPLICATES))


def certified(device: Device, seed: int) -> PixelStatistics:
    """A pilot decides and is dropped; the picture follows."""
    tracer = tracer_of(device, seed, True)
    pilot = tracer.trace(WINDOW, 0, PILOT, even(WINDOW, PILOT, pilot=True)).sums
    values = error_levels(WINDOW, pilot_of(WINDOW, [pixel_statistics(WINDOW, pilot)]), 1.25)
    levels = LevelMap(WINDOW, values)
    film = TileAccumulator(WINDOW, REPLICATES)
    end = levels.end_for(SAMPLES)
    for first, count in aligned_ranges(0, end):
        film.add(tracer.trace(WINDOW, first, count, levels.allotment(WINDOW, end)))
    return pixel_statistics(WINDOW, film.fold(end))


def uniform(device: Device, seed: int) -> PixelStatistics:
    node = tracer_of(device, SEEDS + seed, False).trace(WINDOW, 0, SAMPLES)
    return pixel_statistics(WINDOW, node.sums)


@pytest.fixture(scope="module")
def pictures(device: Device) -> Any:
    """pictures(certified or uniform) -> Pictures."""

    @lru_cache
    def run(way: Any) -> Pictures:
        found = [way(device, seed) for seed in range(SEEDS)]
        return Pictures(
            np.stack([p.mean[..., :3] for p in found]),
            np.stack([p.variance[..., :3] for p in found]),
            np.stack([p.taken for p in found]),
        )

    return run


def test_samples_go_where_they_are_needed(pictures: Any) -> None:
    taken = pictures(certified).taken
    assert taken.mean() == pytest.approx(SAMPLES * REPLICATES, rel=0.1)
    assert taken.max() >= 4 * taken.min()


def test_certified_pictures_are_unbiased(pictures: Any) -> None:
    a, b = pictures(certified).blocks, pictures(uniform).blocks
    for x, y in ((a, b), (a.mean(axis=(1, 2, 3)), b.mean(axis=(1, 2, 3)))):
        error = np.sqrt((x.var(axis=0, ddof=1) + y.var(axis=0, ddof=1)) / SEEDS)
        assert (np.abs(x.mean(axis=0) - y.mean(axis=0)) < SIGMAS * error).all()


def test_certified_variance_is_the_real_one(pictures: Any) -> None:
    """The map differs from seed to seed: the variance of pixels over seeds is the mean of what they claim."""
    seen = pictures(certified)
    assert 0.9 < seen.variance.mean() / seen.mean.var(axis=0, ddof=1).mean() < 1.1
