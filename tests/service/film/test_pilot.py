"""Which blocks a pilot takes, and what they say of the whole picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sums import no_sums
from penumbra_service.film.error import TileSummary, summarize
from penumbra_service.film.grid import POOL_BLOCK
from penumbra_service.film.pilot import (
    affordable,
    blocks_of,
    choose_blocks,
    most_blocks,
    pilot_point,
    round_ends,
)
from penumbra_service.film.predict import Point, error_at, splitting_price
from penumbra_service.film.statistics import pixel_statistics

WINDOWS = st.builds(Tile, st.integers(0, 100), st.integers(0, 100), st.integers(1, 300), st.integers(1, 300))


@given(WINDOWS)
def test_blocks_make_up_the_window(window: Tile) -> None:
    covered = np.zeros((window.height, window.width), int)
    for block in blocks_of(window):
        x, y = block.x - window.x, block.y - window.y
        covered[y : y + block.height, x : x + block.width] += 1
        assert block.x // POOL_BLOCK == (block.x + block.width - 1) // POOL_BLOCK
    assert (covered == 1).all()


@given(WINDOWS, st.integers(1, 200), st.integers(0, 2**64 - 1))
def test_no_block_is_taken_twice_and_the_seed_decides(window: Tile, count: int, seed: int) -> None:
    blocks = blocks_of(window)
    chosen = choose_blocks(blocks, count, seed)
    assert len(set(chosen)) == len(chosen) == min(count, len(blocks))
    assert chosen == choose_blocks(blocks, count, seed)


def test_the_choice_is_spread_over_the_picture() -> None:
    """Of 64 blocks out of 32 x 32, each of the 64 squares of 4 x 4 blocks has exactly one."""
    blocks = blocks_of(Tile(0, 0, 512, 512))
    for seed in range(20):
        squares = {(b.x // 64, b.y // 64) for b in choose_blocks(blocks, 64, seed)}
        assert len(squares) == 64


def test_every_block_is_as_likely_as_any_other() -> None:
    blocks = blocks_of(Tile(0, 0, 160, 96))  # 60 of them: 7 do not divide it
    hits = dict.fromkeys(blocks, 0)
    for seed in range(6000):
        for block in choose_blocks(blocks, 7, seed):
            hits[block] += 1
    expected = 6000 * 7 / 60
    # a false alarm in 1e-6: 60 counts of standard deviation below sqrt(expected)
    assert max(abs(n - expected) for n in hits.values()) < 5.7 * math.sqrt(expected)


@pytest.mark.parametrize("replicates", [1, 2, 4, 8, 16])
def test_rounds_go_from_16_to_128_samples(replicates: int) -> None:
    assert [replicates * end for end in round_ends(replicates)] == [16, 32, 64, 128]


def test_time_buys_rounds_first_and_blocks_then() -> None:
    ends, most = round_ends(8), most_blocks()
    assert affordable(1e9, 2.0, 8, ends, most) == (most, 4)
    samples = most / 4 * POOL_BLOCK**2 * 128
    assert affordable(1.01 * samples, 1.0, 8, ends, most) == (most // 4, 4)
    assert affordable(0.9 * samples, 1.0, 8, ends, most)[1] == 3
    assert affordable(1.0, 2.0, 8, ends, most) == (1, 1)


def block(variance: float, value: float) -> TileSummary:
    """A block all of whose pixels are alike: two replicates, a standard error above and below the mean."""
    sums = no_sums((2, POOL_BLOCK, POOL_BLOCK), wide=True)
    sums["taken"] = sums["lit"] = 32
    off = math.sqrt(variance) * np.array([-1.0, 1.0])
    sums["rgba"] = 32 * (value + off)[:, None, None, None]
    pixels = pixel_statistics(Tile(0, 0, POOL_BLOCK, POOL_BLOCK), sums)
    return summarize(pixels)


def test_a_pilot_estimates_the_error_of_the_whole_picture() -> None:
    """Over 400 pictures of 256 blocks, 32 of each are right on average, and their deviation is the real one."""
    random = np.random.default_rng(3)
    places = blocks_of(Tile(0, 0, 256, 256))
    off, deviations, allowances = [], [], []
    for seed in range(400):
        every = [block(v, 1.0) for v in random.lognormal(-5, 0.7, 256)]
        truth = pilot_point(every, 64, 1.0, 256, 0.95)
        chosen = set(choose_blocks(places, 32, seed))
        part = [summary for summary, place in zip(every, places, strict=True) if place in chosen]
        told = pilot_point(part, 64, 1.0, 256, 0.95)
        off.append(told.relmse / truth.relmse - 1)
        deviations.append(told.deviation)
        allowances.append((told.upper / told.relmse - 1) / (truth.upper / truth.relmse - 1))
    real = np.std(off)
    assert abs(np.mean(off)) < 5 * real / np.sqrt(400)
    assert np.sqrt(1 - 32 / 256) * np.mean(deviations) == pytest.approx(real, rel=0.15)
    assert np.mean(allowances) == pytest.approx(1.0, rel=0.1)


def test_a_pilot_that_saw_no_variance_says_so() -> None:
    unknown = block(0.0, 0.0)
    unknown.blocks.pixels[:] = 0  # of none is the variance known
    point = pilot_point([unknown], 64, 1.0, 256, 0.95)
    assert math.isnan(point.relmse)
    assert math.isnan(point.upper)


def test_the_price_of_splitting_is_that_of_shorter_sequences() -> None:
    """Of R sequences of n/R samples with variance n^-theta: their mean has (n/R)^-theta / R."""
    for theta in (1.0, 1.2, 1.44):
        for r in (2, 4, 8, 16):
            samples = 1000.0
            variance = (samples / r) ** -theta / r
            undivided = variance ** (-1 / theta)
            assert splitting_price(r, theta) == pytest.approx(samples / undivided)


def test_the_error_after_so_many_samples_falls_as_it_fell() -> None:
    def relmse(n: int) -> float:
        return 0.5 / n + 2.0 * n**-1.5

    points = [Point(n, float(n), relmse(n), relmse(n), 0.1) for n in (16, 32, 64, 128)]
    told = error_at(points, 1024)
    assert told is not None
    error, low, high = told
    assert error == pytest.approx(math.sqrt(relmse(1024)), rel=1e-6)
    assert low < error < high
    assert error_at([], 64) is None
