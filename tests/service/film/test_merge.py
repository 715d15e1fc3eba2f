"""Renders with different seeds, taken together: the mean of all samples, and the variance of that mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sums import no_sums
from penumbra_service.film import flags
from penumbra_service.film.develop import RGBA, Developed, float_channels, integer_channels
from penumbra_service.film.merge import merge_bands, picture_error
from penumbra_service.film.statistics import pixel_statistics

TILE = Tile(0, 0, 4, 4)
SHAPE = (TILE.height, TILE.width)


def band(
    mean: NDArray[np.float64], variance: NDArray[np.float64], count: NDArray[np.int64], bits: int = 0
) -> Developed:
    """A picture all of whose channels are alike."""
    floats = {c: mean.astype(np.float32) for c in RGBA}
    floats |= {f"Variance.{c}": variance.astype(np.float32) for c in RGBA}
    floats |= {f"StdErr.{c}": np.sqrt(variance).astype(np.float32) for c in RGBA}
    flagged = np.where(count == 0, bits | flags.EMPTY | flags.NO_VARIANCE, bits).astype(np.uint32)
    integers = {
        "SampleCount": count.astype(np.uint32),
        "InvalidCount": np.zeros(SHAPE, np.uint32),
        "Flags": flagged,
    }
    return Developed(TILE, floats, integers)


def random_band(seed: int, bits: int = 0) -> Developed:
    random = np.random.default_rng(seed)
    count = random.integers(0, 6, SHAPE) * 8
    variance = np.where(count > 0, random.lognormal(0, 2, SHAPE), np.nan)
    return band(np.where(count > 0, random.lognormal(0, 2, SHAPE), 0.0), variance, count, bits)


def close(a: Developed, b: Developed) -> None:
    for name in a.floats:
        np.testing.assert_allclose(a.floats[name], b.floats[name], rtol=1e-6, err_msg=name)
    for name in a.integers:
        np.testing.assert_array_equal(a.integers[name], b.integers[name], err_msg=name)


SEEDS = st.lists(st.integers(0, 2**32), min_size=3, max_size=5, unique=True)


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_order_and_grouping_do_not_count(seeds: list[int]) -> None:
    parts = [random_band(seed) for seed in seeds]
    at_once = merge_bands(parts)
    close(at_once, merge_bands(parts[::-1]))
    close(at_once, merge_bands([merge_bands(parts[:2]), *parts[2:]]))


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_the_sums_of_all_samples_decide(seeds: list[int]) -> None:
    """Oracle: sums and their variances add up, in float64."""
    parts = [random_band(seed) for seed in seeds]
    merged = merge_bands(parts)
    count = np.sum([p.integers["SampleCount"].astype(np.float64) for p in parts], axis=0)
    total = np.sum([p.integers["SampleCount"] * p.floats["R"].astype(np.float64) for p in parts], axis=0)
    spread = np.nansum(
        [p.integers["SampleCount"] ** 2.0 * p.floats["Variance.R"].astype(np.float64) for p in parts], axis=0
    )
    some = count > 0
    np.testing.assert_array_equal(merged.integers["SampleCount"], count)
    np.testing.assert_allclose(merged.floats["R"][some], (total / np.maximum(count, 1))[some], rtol=1e-6)
    np.testing.assert_allclose(
        merged.floats["Variance.R"][some], (spread / np.maximum(count, 1) ** 2)[some], rtol=1e-6
    )
    np.testing.assert_allclose(merged.floats["StdErr.R"] ** 2, merged.floats["Variance.R"], rtol=1e-5)
    assert np.isnan(merged.floats["Variance.R"][~some]).all()
    assert (merged.floats["R"][~some] == 0).all()


def simulated(random: np.random.Generator, samples: Sequence[int], replicates: int = 8) -> list[Developed]:
    """Renders of a constant picture of value 1 whose samples are exponential: V is known to be 1 / n."""
    parts = []
    for n in samples:
        sums = no_sums((replicates, *SHAPE))
        sums["taken"] = sums["lit"] = n // replicates
        drawn = random.gamma(n / replicates, 1.0, (replicates, *SHAPE))
        sums["rgba"] = drawn[..., None]
        pixels = pixel_statistics(TILE, sums)
        parts.append(band(pixels.mean[..., 0], pixels.variance[..., 0], pixels.taken.astype(np.int64)))
    return parts


def test_the_variance_is_that_of_the_merged_mean() -> None:
    """Estimated over real, over 4,000 merges of 64, 128 and 16 samples, and 1 / 208 by the closed form."""
    random = np.random.default_rng(5)
    merged = [merge_bands(simulated(random, (64, 128, 16))) for _ in range(4000)]
    means = np.array([m.floats["R"] for m in merged], np.float64)
    claimed = np.array([m.floats["Variance.R"] for m in merged], np.float64)
    error = means.std() / np.sqrt(means.size)
    assert abs(means.mean() - 1.0) < 5 * error
    assert claimed.mean() == pytest.approx(1 / 208, rel=0.02)
    assert claimed.mean() == pytest.approx(means.var(), rel=0.03)


def test_what_makes_one_error_bar_uncertain_makes_the_merged_one_so() -> None:
    full = np.full(SHAPE, 8)
    one = np.ones(SHAPE)
    merged = merge_bands([band(one, one, full, flags.HEAVY_TAILED), band(one, one, full, flags.BLOCK)])
    assert (merged.integers["Flags"] == flags.HEAVY_TAILED | flags.BLOCK).all()
    unknown = merge_bands([band(one, one, full), band(one, one * np.nan, full, flags.NO_VARIANCE)])
    assert (unknown.integers["Flags"] == flags.NO_VARIANCE).all()
    assert np.isnan(unknown.floats["Variance.R"]).all()


def test_pixels_that_are_empty_in_one_render_come_from_the_other() -> None:
    one, full = np.ones(SHAPE), np.full(SHAPE, 8)
    merged = merge_bands([band(one * 0, one * np.nan, full * 0), band(3 * one, one, full)])
    np.testing.assert_array_equal(merged.floats["R"], 3)
    np.testing.assert_array_equal(merged.floats["Variance.R"], 1)
    assert not merged.integers["Flags"].any()


def test_other_pixels_or_channels_are_refused() -> None:
    a = random_band(1)
    moved = Developed(Tile(1, 0, 4, 4), a.floats, a.integers)
    with pytest.raises(ValueError, match="different pixels"):
        merge_bands([a, moved])


def test_names_and_order_of_channels_stay() -> None:
    merged = merge_bands([random_band(1), random_band(2)])
    assert list(merged.floats) == float_channels()
    assert list(merged.integers) == integer_channels()


def test_the_error_of_a_developed_picture_is_pooled_variance_over_pooled_signal() -> None:
    full = np.full(SHAPE, 8)
    error, flagged = picture_error([band(np.full(SHAPE, 2.0), np.full(SHAPE, 0.04), full, flags.REJECTED)])
    assert error.relmse == pytest.approx(0.04 / (4 + 0.01), rel=0.02)
    assert error.mse == pytest.approx(0.04)
    assert flagged == 1.0
