"""The variance channel is the variance of the pixel's mean: estimated over real, for every stochastic sampler."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.parse import scene_from_json
from penumbra_service.film.statistics import pixel_statistics

TILE = Tile(0, 0, 32, 32)
SEEDS = 100
STOCHASTIC = ["random", "independent", "stratified", "jittered", "sobol", "blue_noise"]


def soft_shadow(sampler: str) -> dict[str, Any]:
    """A lens, an area light, a sphere's shadow on a floor: edges and smooth parts."""
    return {
        "camera": {
            "type": "perspective",
            "fov": 40,
            "transform": {"look_at": {"origin": [0, 2, 4], "target": [0, 0.3, 0]}},
            "lens": {"aperture_radius": 0.1, "focus_distance": 4},
        },
        "film": {"width": 32, "height": 32},
        "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
        "shapes": [
            {"type": "quad", "origin": [-5, 0, 5], "u": [10, 0, 0], "v": [0, 0, -10], "material": "gray"},
            {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.5, "material": "gray"},
            {
                "type": "quad",
                "origin": [-1, 3, -1],
                "u": [2, 0, 0],
                "v": [0, 0, 2],
                "emission": {"radiance": 3},
            },
        ],
        "integrator": {"max_bounces": 2},
        "sampler": {"type": sampler},
    }


Many = Callable[[str], tuple[NDArray[np.float64], NDArray[np.float64]]]


@pytest.fixture(scope="module")
def many(device: Device) -> Many:
    """many(sampler) -> pixel means (SEEDS, h, w, 3) and the variance that each picture claims, (SEEDS,)."""

    @lru_cache
    def run(sampler: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scene = scene_from_json({"version": 1, **soft_shadow(sampler)})
        tracer = Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(8, 4), program="generic")
        means, claimed = [], []
        for seed in range(SEEDS):
            tracer.reseed(seed)
            pixels = pixel_statistics(TILE, tracer.trace(TILE, 0, 4).sums)
            means.append(pixels.mean[..., :3])
            claimed.append(np.nanmean(pixels.variance[..., :3]))
        return np.stack(means), np.array(claimed)

    return run


@pytest.mark.parametrize("sampler", STOCHASTIC)
def test_estimated_variance_is_the_real_one(many: Many, sampler: str) -> None:
    means, claimed = many(sampler)
    assert 0.9 < claimed.mean() / means.var(axis=0, ddof=1).mean() < 1.1


@pytest.mark.parametrize("sampler", ["random", "jittered", "sobol", "blue_noise"])
def test_samplers_agree_on_the_picture(many: Many, sampler: str) -> None:
    """A z-test of image means over seeds; `stratified` keeps fixed pixel positions, and so another picture."""
    a, b = (many(name)[0].mean(axis=(1, 2, 3)) for name in ("independent", sampler))
    error = np.sqrt(a.var(ddof=1) / SEEDS + b.var(ddof=1) / SEEDS)
    assert abs(a.mean() - b.mean()) < 5.3 * error


def test_better_samplers_have_less_variance(many: Many) -> None:
    real = {s: many(s)[0].var(axis=0, ddof=1).mean() for s in ("independent", "jittered", "sobol")}
    assert real["jittered"] < 0.8 * real["independent"]
    assert real["sobol"] < 0.8 * real["independent"]
