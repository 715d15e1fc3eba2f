"""The variance channel is the variance of the pixel's mean: estimated over real, for every stochastic sampler."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

SEEDS = 100
STOCHASTIC = ["independent", "stratified", "jittered", "sobol", "blue_noise"]


def soft_shadow(sampler: str, seed: int) -> dict[str, Any]:
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
        "sampler": {"type": sampler, "seed": seed},
    }


@pytest.fixture(scope="module")
def means() -> dict[str, tuple[Any, Any]]:
    return {}


@pytest.mark.parametrize("sampler", STOCHASTIC)
def test_estimated_variance_is_the_real_one(
    render: Any, sampler: str, means: dict[str, tuple[Any, Any]]
) -> None:
    pictures = [render(soft_shadow(sampler, seed), samples=32, replicates=8) for seed in range(SEEDS)]
    stack = np.stack([p.mean for p in pictures])
    estimated = np.mean([p.variance.mean() for p in pictures])
    real = stack.var(axis=0, ddof=1).mean()
    assert 0.9 < estimated / real < 1.1
    means[sampler] = stack.mean(axis=(1, 2, 3)), stack


@pytest.mark.parametrize("sampler", [s for s in STOCHASTIC if s not in ("independent", "stratified")])
def test_samplers_agree_on_the_picture(render: Any, sampler: str, means: dict[str, tuple[Any, Any]]) -> None:
    """A z-test of image means over seeds; `stratified` keeps fixed pixel positions, and so another picture."""
    for name in ("independent", sampler):
        if name not in means:
            pytest.skip("the variance test of this sampler did not finish")
    a, b = means["independent"][0], means[sampler][0]
    error = np.sqrt(a.var(ddof=1) / SEEDS + b.var(ddof=1) / SEEDS)
    assert abs(a.mean() - b.mean()) < 5.3 * error


def test_better_samplers_have_less_variance(means: dict[str, tuple[Any, Any]]) -> None:
    if not {"independent", "jittered", "sobol"} <= means.keys():
        pytest.skip("the variance tests did not finish")
    real = {name: stack.var(axis=0, ddof=1).mean() for name, (_, stack) in means.items()}
    assert real["jittered"] < 0.8 * real["independent"]
    assert real["sobol"] < 0.8 * real["independent"]
