"""Claims about the samplers: uniform, stratified and independent as promised, at any index and dimension."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.samplers import LENS, PIXEL, TIME, Draw, bounce
from scipy.stats import chi2, kstest, norm

FALSE_ALARM = 1e-6
Z = float(norm.isf(FALSE_ALARM / 2))

STOCHASTIC = ["random", "independent", "stratified", "jittered", "sobol", "blue_noise"]


@pytest.fixture(scope="session")
def samplers(device: Device) -> Callable[[str], Draw]:
    made: dict[str, Draw] = {}

    def get(name: str) -> Draw:
        if name not in made:
            made[name] = Draw(device, name)
        return made[name]

    return get


def cell_2d(points: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Which of `count` equal cells a point lies in: rows near to a square grid, the longer ones first."""
    rows = max(int(np.floor(np.sqrt(count) + 0.5)), 1)
    lengths = np.full(rows, count // rows)
    lengths[: count % rows] += 1
    starts = np.concatenate([[0], np.cumsum(lengths)])
    row = np.searchsorted(starts / count, points[..., 1].astype(np.float64), side="right") - 1
    return np.asarray(starts[row] + np.floor(points[..., 0] * lengths[row]).astype(np.int64))


def each_once(cells: NDArray[np.int64], count: int) -> bool:
    """Whether along the last axis every cell is hit exactly once."""
    return bool((np.sort(cells, axis=-1) == np.arange(count)).all())


@pytest.mark.parametrize("name", STOCHASTIC)
@pytest.mark.parametrize("strata", [0, 5, 16])
def test_numbers_are_uniform(samplers: Any, name: str, strata: int) -> None:
    draw = samplers(name)
    x, y = np.meshgrid(np.arange(128), np.arange(128))
    for number, dimension in enumerate((TIME, bounce(3, 2), bounce(65535, 4))):
        u = draw(1, dimension, 3 + number, x, y, number, strata=strata, seed=11, film=128)
        assert u.min() >= 0
        assert u.max() < 1
        assert kstest(u.reshape(-1), "uniform").pvalue > FALSE_ALARM


@pytest.mark.parametrize("name", STOCHASTIC)
@pytest.mark.parametrize("strata", [0, 5, 16])
def test_points_are_uniform(samplers: Any, name: str, strata: int) -> None:
    draw = samplers(name)
    x, y = np.meshgrid(np.arange(128), np.arange(128))
    for number, dimension in enumerate((LENS, bounce(3, 3), bounce(0, 1, 10**6))):
        points = draw(2, dimension, 3 + number, x, y, number, strata=strata, seed=12, film=128).reshape(-1, 2)
        assert points.min() >= 0
        assert points.max() < 1
        seen, _, _ = np.histogram2d(*points.T, bins=16, range=[[0, 1], [0, 1]])
        expected = len(points) / 256
        assert chi2.sf(((seen - expected) ** 2 / expected).sum(), 255) > FALSE_ALARM


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16, 60, 64])
def test_jittered_hits_each_stratum_once_in_every_domain(samplers: Any, count: int) -> None:
    draw = samplers("jittered")
    dimension = np.array([PIXEL, LENS, bounce(2, 3)])[:, None, None]
    points = draw(2, dimension, np.arange(count), np.arange(20)[:, None], strata=count)
    assert each_once(cell_2d(points, count), count)
    numbers = draw(1, TIME, np.arange(count), np.arange(20)[:, None], strata=count)
    assert each_once(np.floor(numbers.astype(np.float64) * count).astype(np.int64), count)


def test_jittered_goes_on_past_its_plan_with_new_strata(samplers: Any) -> None:
    draw = samplers("jittered")
    first = draw(2, LENS, np.arange(12), np.arange(9)[:, None], strata=12)
    second = draw(2, LENS, 12 + np.arange(12), np.arange(9)[:, None], strata=12)
    assert each_once(cell_2d(second, 12), 12)
    assert not np.isin(first, second).any()


@pytest.mark.parametrize("name", ["jittered", "stratified", "regular"])
def test_without_a_plan_strata_double(samplers: Any, name: str) -> None:
    draw = samplers(name)
    for level in range(8):
        count = 1 << level
        points = draw(2, LENS, count + np.arange(count), np.arange(5)[:, None])
        assert each_once(cell_2d(points, count), count)


@pytest.mark.parametrize("count", [1, 6, 16])
def test_stratified_takes_stratum_centres_in_the_pixel_alone(samplers: Any, count: int) -> None:
    draw = samplers("stratified")
    pixel = draw(2, PIXEL, np.arange(count), np.arange(30)[:, None], strata=count)
    assert each_once(cell_2d(pixel, count), count)
    assert len(np.unique(pixel.reshape(-1, 2), axis=0)) == count
    lens = draw(2, LENS, np.arange(count), np.arange(30)[:, None], strata=count)
    assert each_once(cell_2d(lens, count), count)
    assert len(np.unique(lens.reshape(-1, 2), axis=0)) == 30 * count


def test_stratified_with_one_sample_is_the_pixels_centre(samplers: Any) -> None:
    np.testing.assert_array_equal(samplers("stratified")(2, PIXEL, 0, strata=1), [0.5, 0.5])


@pytest.mark.parametrize("replicates", [1, 4])
def test_regular_is_one_grid_for_all_pixels_seeds_and_replicates(samplers: Any, replicates: int) -> None:
    draw = samplers("regular")
    count = 9
    total = count * replicates
    r, i = np.meshgrid(np.arange(replicates), np.arange(count))
    keys = {"strata": count, "replicates": replicates}
    for dimension in (PIXEL, LENS, bounce(1, 3)):
        points = draw(2, dimension, i, 0, 0, r, seed=1, **keys)
        assert each_once(cell_2d(points.reshape(-1, 2), total), total)
        np.testing.assert_array_equal(points, draw(2, dimension, i, 17, 3, r, seed=2, **keys))
    numbers = np.sort(draw(1, TIME, i, 0, 0, r, **keys).reshape(-1))
    np.testing.assert_allclose(numbers, (np.arange(total) + 0.5) / total, rtol=1e-6)


def test_regular_with_m_light_points_keeps_them_fixed(samplers: Any) -> None:
    """The lecture's hard shadows: one sample, m fixed points on the light."""
    draw = samplers("regular")
    points = draw(2, bounce(0, 1), np.arange(4), np.arange(10)[:, None], strata=1, m=4)
    assert (points == points[0]).all()
    expected = {(x, y) for x in (0.25, 0.75) for y in (0.25, 0.75)}
    assert {tuple(p) for p in points[0].tolist()} == expected
    np.testing.assert_array_equal(draw(2, PIXEL, 0, strata=1), [0.5, 0.5])


@pytest.mark.parametrize("hit", [0, 1])
def test_sums_of_a_hits_light_and_direction_vary_as_if_these_were_drawn_apart(
    samplers: Any, hit: int
) -> None:
    """The pairs share a shuffle, but are scrambled each by itself: means of terms that are added are uncorrelated."""
    pixels = np.arange(40_000)[:, None]
    light, direction = (samplers("sobol")(2, bounce(hit, slot), np.arange(16), pixels, 3) for slot in (1, 3))
    for axis, other in itertools.product(range(2), repeat=2):
        f = np.sin(3 * light[..., axis].astype(np.float64)) + (light.sum(axis=-1) < 0.7)
        g = np.exp(direction[..., other].astype(np.float64)) + ((direction**2).sum(axis=-1) < 0.5)
        assert abs(np.corrcoef(f.mean(axis=1), g.mean(axis=1))[0, 1]) < Z / np.sqrt(len(pixels))


@pytest.mark.parametrize(("log2", "missing"), [(3, 1), (4, 2), (6, 1), (8, 2)])
@pytest.mark.parametrize("slot", [1, 3], ids=["light", "direction"])
def test_sobol_spreads_the_pixel_with_what_its_first_hit_sends_out(
    samplers: Any, slot: int, log2: int, missing: int
) -> None:
    """Every box of volume 2^missing / 2^log2 whose sides are powers of two has 2^missing of 2^log2 points in four dimensions;
    and each pair alone is spread in every elementary interval."""
    draw = samplers("sobol")
    index, pixels = 5 * (1 << log2) + np.arange(1 << log2), np.arange(8)[:, None]
    pixel, sent = (draw(2, d, index, pixels, 7).astype(np.float64) for d in (PIXEL, bounce(0, slot)))
    for points, lost in ((pixel, 0), (sent, 0), (np.concatenate([pixel, sent], axis=-1), missing)):
        free = log2 - lost
        for digits in itertools.product(range(free + 1), repeat=points.shape[-1]):
            if sum(digits) != free:
                continue
            cells = np.zeros(points.shape[:-1], np.int64)
            for axis, bits in enumerate(digits):
                cells = (cells << bits) + np.floor(points[..., axis] * (1 << bits)).astype(np.int64)
            counts = np.stack([np.bincount(row, minlength=1 << free) for row in cells])
            assert (counts == 1 << lost).all()


@pytest.mark.parametrize("name", ["sobol", "blue_noise"])
@pytest.mark.parametrize("log2", [0, 1, 4, 7])
def test_powers_of_two_are_stratified_in_every_elementary_interval(
    samplers: Any, name: str, log2: int
) -> None:
    draw = samplers(name)
    count = 1 << log2
    for block in (0, 3) if name == "sobol" else (0,):
        index = block * count + np.arange(count)
        points = draw(2, bounce(1, 3), index, np.arange(20)[:, None], 7, strata=count).astype(np.float64)
        for across in range(log2 + 1):
            cells = np.floor(points[..., 0] * (1 << across)) * (count >> across)
            cells = cells + np.floor(points[..., 1] * (count >> across))
            assert each_once(cells.astype(np.int64), count)
        numbers = draw(1, TIME, index, np.arange(20)[:, None], 7, strata=count).astype(np.float64)
        assert each_once(np.floor(numbers * count).astype(np.int64), count)


@pytest.mark.parametrize(("name", "strata", "m"), [("jittered", 5, 3), ("sobol", 8, 4), ("blue_noise", 8, 4)])
def test_draws_of_one_sample_are_stratified_with_those_of_the_others(
    samplers: Any, name: str, strata: int, m: int
) -> None:
    total = strata * m
    points = samplers(name)(2, bounce(0, 1), np.arange(total), np.arange(20)[:, None], strata=strata, m=m)
    if name == "jittered":
        assert each_once(cell_2d(points, total), total)
    else:
        cells = np.floor(points[..., 0].astype(np.float64) * total).astype(np.int64)
        assert each_once(cells, total)


def test_better_samplers_have_less_variance_on_a_smooth_integrand(samplers: Any) -> None:
    count, pixels = 64, 2000
    variances = {}
    for name in ("independent", "jittered", "sobol"):
        points = samplers(name)(2, LENS, np.arange(count), np.arange(pixels)[:, None], strata=count)
        value = np.sin(2 * points[..., 0]) * np.exp(points[..., 1])
        variances[name] = value.mean(axis=1).var()
    # Stratified sampling in 2-D falls as n^-2, scrambled nets as n^-3.
    assert variances["jittered"] < variances["independent"] / 20
    assert variances["sobol"] < variances["jittered"] / 5


@pytest.mark.parametrize("name", ["jittered", "sobol", "blue_noise"])
@pytest.mark.parametrize("count", [3, 7, 13])
def test_any_number_of_samples_is_unbiased(samplers: Any, name: str, count: int) -> None:
    pixels = 20_000
    points = samplers(name)(
        2, LENS, np.arange(count), 0, np.arange(pixels)[:, None], strata=count, film=32768
    )
    value = (points[..., 0].astype(np.float64) ** 2 * points[..., 1]).mean(axis=1)
    assert abs(value.mean() - 1 / 6) < Z * value.std() / np.sqrt(pixels)


def test_blue_noise_turns_the_error_to_high_frequencies(samplers: Any) -> None:
    x, y = np.meshgrid(np.arange(64), np.arange(64))
    for count in (1, 4):
        keys = {"strata": count, "film": 64}
        points = samplers("blue_noise")(2, LENS, np.arange(count), x[..., None], y[..., None], **keys)
        error = (points[..., 0] * points[..., 1]).mean(axis=-1) - 0.25
        blocks = error.reshape(16, 4, 16, 4).mean(axis=(1, 3))
        # White noise would leave 1/16 of the variance in blocks of 16.
        assert blocks.var() < error.var() / 16 / 4


def test_orders_of_blue_noise_are_those_of_all_pixels(samplers: Any) -> None:
    """With one sample the pixels of a power-of-two block share one net between them."""
    x, y = np.meshgrid(np.arange(16), np.arange(16))
    points = samplers("blue_noise")(2, LENS, 0, x + 32, y + 16, strata=1, film=64).reshape(-1, 2)
    for bits in range(9):
        cells = np.floor(points[:, 0] * 2.0**bits) * 2 ** (8 - bits) + np.floor(
            points[:, 1] * 2.0 ** (8 - bits)
        )
        assert each_once(cells.astype(np.int64), 256)
