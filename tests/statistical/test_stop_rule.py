"""A render that stops at an error is no worse than it says: the rule's bias, measured over seeds."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile, aligned_ranges
from penumbra_service.film.accumulator import TileAccumulator
from penumbra_service.film.error import ImageError, image_error, summarize
from penumbra_service.film.replicates import DEFAULT_REPLICATES
from penumbra_service.film.statistics import PixelStatistics, pixel_statistics
from penumbra_service.film.stop import StopRule

REPLICATES = DEFAULT_REPLICATES
THOROUGH = int(os.environ.get("PENUMBRA_SEEDS", "100")) >= 1000
CASES = [("penumbra", "sobol", 0.02), ("edge", "independent", 0.05)][: 2 if THOROUGH else 1]


@dataclass(frozen=True)
class Stopped:
    """A render as the rule left it."""

    samples: int
    pixels: PixelStatistics
    error: ImageError


def render_until(lab: Any, seed: int, target: float) -> Stopped:
    """As engine.runner does it: check points of film.stop, on the picture's pooled error."""
    rule = StopRule(REPLICATES, samples=4096 // REPLICATES, relative_error=target)
    lab.tracer.reseed(seed)
    tile = Tile(0, 0, *lab.truth.shape)
    kept = TileAccumulator(tile, REPLICATES)
    end = 0
    while True:
        following = rule.next_end(end)
        assert following is not None
        for first, count in aligned_ranges(end, following):
            kept.add(lab.tracer.trace(tile, first, count))
        end = following
        kept.set_barriers((end,))
        pixels = pixel_statistics(tile, kept.fold(end))
        error = image_error([summarize(pixels)])
        if rule.decide(end, 0.0, error):
            return Stopped(end * REPLICATES, pixels, error)


@pytest.mark.parametrize(("scene", "sampler", "target"), CASES)
def test_stopping_at_an_error_biases_neither_the_picture_nor_its_error(
    lab: Any, record: Any, seeds: int, scene: str, sampler: str, target: float
) -> None:
    """Picture: mean over seeds against the closed form. Error: claimed against real mean squared error."""
    opened = lab(scene, sampler)
    renders = [render_until(opened, seed, target) for seed in range(seeds)]
    means = np.array([r.pixels.mean[..., 0] for r in renders])
    bias = float((means.mean(axis=0) - opened.truth).sum() / opened.truth.sum())
    deviation = float(means.sum(axis=(1, 2)).std(ddof=1) / math.sqrt(seeds) / opened.truth.sum())
    real = float(((means - opened.truth) ** 2).mean())
    claimed = float(np.mean([r.error.mse for r in renders]))
    samples = [r.samples for r in renders]
    record(
        f"stop {scene} {sampler}",
        {
            "seeds": seeds, "target": target, "bias": bias, "bias_deviation": deviation,
            "claimed_over_real": claimed / real, "samples": [min(samples), float(np.median(samples)), max(samples)],
        },
    )  # fmt: skip
    assert abs(bias) < 0.01
    assert claimed == pytest.approx(real, rel=0.1)
    within = np.mean([r.error.upper(0.95) <= target**2 for r in renders])
    assert within == 1.0 or max(samples) == 4096
