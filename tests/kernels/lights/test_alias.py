"""Choosing lights: the probabilities that are written down are those with which numbers of 24 bits choose."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from penumbra_kernels.compile.alias import MAX_ENTRIES, STEPS, alias_table, quantised_cdf, quantised_pmf
from penumbra_kernels.hardcases.lights import many_powers


def choose_on_host(table: np.ndarray, k: np.ndarray) -> np.ndarray:
    """What choice.cl does, in integers, for the uniform numbers k 2^-24."""
    scaled = k.astype(np.int64) * len(table)
    entry, rest = scaled >> 24, (scaled & (STEPS - 1)) / STEPS
    return np.where(rest < table["threshold"][entry], entry, table["other"][entry])


WEIGHTS = {
    "one": np.array([3.0]),
    "three alike": np.ones(3),
    "one dark": np.array([1.0, 0.0, 2.0]),
    "all dark": np.zeros(5),
    "1e12 apart": np.array([1e-6, 1e6, 1.0, 0.0]),
    "ten thousand": many_powers(),
}


@pytest.mark.parametrize("name", WEIGHTS)
def test_every_uniform_number_is_counted_in_the_pmf(name: str) -> None:
    table = alias_table(WEIGHTS[name])
    chosen = np.bincount(choose_on_host(table, np.arange(STEPS)), minlength=len(table))
    assert np.array_equal(chosen, table["pmf"].astype(np.float64) * STEPS)


@pytest.mark.parametrize("name", WEIGHTS)
def test_steps_follow_the_weights(name: str) -> None:
    weights = WEIGHTS[name]
    steps = quantised_pmf(weights)
    assert steps.sum() == STEPS
    if weights.any():
        assert np.array_equal(steps > 0, weights > 0)
        exact = weights / weights.sum() * STEPS
        lifted = np.count_nonzero((steps == 1) & (exact < 1))
        assert np.all(np.abs(steps - exact) <= 1.01 + exact * lifted / STEPS)


def test_extreme_rows_keep_a_step_for_every_texel() -> None:
    weights = np.full((3, 4096), 0.7)
    weights[1, 77] = 1e30
    weights[2] = 0.0
    steps = np.diff(quantised_cdf(weights))
    assert np.all(steps.sum(axis=1) == STEPS)
    assert steps.min() >= 1
    assert steps[1, 77] == STEPS - 4095


def test_a_table_too_long_for_24_bits_is_refused() -> None:
    with pytest.raises(ValueError, match=f"at most {MAX_ENTRIES}"):
        quantised_cdf(np.ones(MAX_ENTRIES + 1))


def test_the_device_chooses_as_the_host(bench) -> None:
    table = alias_table(many_powers())
    scene = bench.scene([bench.light("point")] * len(table), light_table=table)
    k = np.random.default_rng(2).integers(0, STEPS, 300_000)
    k[:3] = 0, 1, STEPS - 1
    light, pmf, same = bench.choose(scene, k * 2.0**-24)
    assert np.array_equal(light, choose_on_host(table, k))
    assert np.array_equal(pmf, table["pmf"][light])
    assert np.array_equal(pmf, same)


def test_choice_frequencies_follow_the_powers(bench) -> None:
    powers = np.array([1.0, 0.0, 4.0, 2.5, 1e-3])
    table = alias_table(powers)
    scene = bench.scene([bench.light("point")] * len(table), light_table=table)
    light, _, _ = bench.choose(scene, bench.uniform(1_000_000, 3, 1)[:, 0])
    counts = np.bincount(light, minlength=5)
    assert bench.chi2_pvalue(counts, powers / powers.sum() * 1_000_000) > 1e-6


@pytest.mark.parametrize("digits", [0.0, 0.75])
@pytest.mark.parametrize("weights", [1.01 ** np.arange(300), many_powers()], ids=["300", "ten thousand"])
def test_the_numbers_of_a_light_are_left_as_points_all_over_it(
    bench, weights: np.ndarray, digits: float
) -> None:
    """Neighbouring numbers that choose a light become places on it from 0 to 1, a step apart, however few they are; the steps
    are filled up by the second number's digits."""
    table = alias_table(weights)
    scene = bench.scene([bench.light("point")] * len(table), light_table=table)
    chosen = choose_on_host(table, np.arange(STEPS))
    for light in np.unique(chosen[:: STEPS // 6]):
        own = np.flatnonzero(chosen == light)
        point = np.stack([own * 2.0**-24, np.full(len(own), digits * 2.0**-12)], axis=-1)
        again, left = bench.choose_points(scene, point)
        assert np.all(again == light)
        assert np.array_equal(left[:, 1], point[:, 1].astype(np.float32))
        begins = np.flatnonzero((np.diff(own) > 1) | (np.diff(left[:, 0]) < 0)) + 1
        for piece in np.split(left[:, 0], begins):
            assert np.allclose(piece, (np.arange(len(piece)) + digits) / len(piece), rtol=0, atol=2e-6)


def test_points_of_a_net_that_choose_a_light_are_a_net_on_it(bench) -> None:
    """Of 256 points of the Sobol sequence a light of chance 1/4 gets 64, one in each cell of 8 x 8."""
    table = alias_table(np.array([1.0, 3.0]))
    scene = bench.scene([bench.light("point")] * 2, light_table=table)
    net = np.floor(scipy.stats.qmc.Sobol(2, seed=5).random(256) * 2.0**24) * 2.0**-24
    light, left = bench.choose_points(scene, net)
    cells = np.floor(left[light == 0] * 8).astype(int)
    assert len(cells) == 64
    assert len(np.unique(cells, axis=0)) == 64
