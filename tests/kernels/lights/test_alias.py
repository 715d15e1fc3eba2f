"""Choosing lights: the probabilities that are written down are those with which numbers of 24 bits choose."""

from __future__ import annotations

import numpy as np
import pytest
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
