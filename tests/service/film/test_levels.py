"""Maps of levels, and how a pilot's statistics become one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.allotment import LEVEL_NONE, own_samples
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sums import no_sums
from penumbra_service.film import levels as level_file
from penumbra_service.film.allocation import (
    MOST,
    UNIFORM_SHARE,
    BlockPilot,
    Saving,
    contrast_levels,
    densities,
    error_levels,
    pilot_of,
    pilot_samples,
    pilot_suffices,
    saving_of,
    smoothed,
    spreading_pays,
    theta_of,
)
from penumbra_service.film.error import EPSILON
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.predict import Point
from penumbra_service.film.statistics import pixel_statistics
from penumbra_service.film.stop import StopRule

WINDOW = Tile(5, 3, 40, 21)


def some_map(kept: int = 0) -> LevelMap:
    choice = np.array([0, 1, 2, 4] + ([LEVEL_NONE] if kept else []), np.uint8)
    return LevelMap(WINDOW, np.random.default_rng(2).choice(choice, (21, 40)), kept)


@pytest.mark.parametrize("kept", [0, 4])
def test_tiles_add_up_to_the_picture(kept: int) -> None:
    levels = some_map(kept)
    assert levels.levels is not None
    for first, count in ((0, 8), (8, 4), (12, 1)):
        one_by_one = sum(
            own_samples(first + count, int(j), kept) - own_samples(first, int(j), kept)
            for j in levels.levels.ravel()
        )
        assert sum(levels.samples(tile, first, count) for tile in TileGrid(WINDOW, 16)) == one_by_one


@pytest.mark.parametrize("kept", [0, 4])
@pytest.mark.parametrize("samples", [4, 5, 16, 100])
def test_the_end_is_the_one_whose_mean_is_nearest(kept: int, samples: int) -> None:
    levels = some_map(kept)
    misses = {end: abs(levels.mean(end) - samples) for end in range(1, 3000)}
    assert misses[levels.end_for(samples)] == min(misses.values())


def test_an_even_map_changes_nothing() -> None:
    even, rule = LevelMap(WINDOW), StopRule(8, 24)
    adaptive = StopRule(8, 24, levels=even)
    assert [even.end_for(n) for n in (1, 7, 64)] == [1, 7, 64]
    assert [adaptive.next_end(n) for n in range(24)] == [rule.next_end(n) for n in range(24)]
    assert adaptive.planned == rule.planned == 192


def test_the_first_look_has_a_sample_a_replicate_on_average() -> None:
    sparse = LevelMap(WINDOW, np.where(np.arange(40) < 2, 0, 6).astype(np.uint8) * np.ones((21, 1), np.uint8))
    first = StopRule(8, relative_error=0.1, levels=sparse).next_end(0)
    assert first is not None
    assert first & (first - 1) == 0
    assert sparse.mean(first) >= 1 > (sparse.mean(first // 2) if first > 1 else 0)


def test_a_map_survives_its_file_and_a_broken_file_is_none() -> None:
    levels = some_map(4)
    data = level_file.encode(levels, "key")
    back = level_file.decode(data, WINDOW, "key")
    assert back is not None
    assert back.levels is not None
    assert levels.levels is not None
    assert (back.levels == levels.levels).all()
    assert back.kept == 4
    for wrong in (None, b"", data[:-1], data + b"x", b"x" + data[1:], data[:40] + b"?" + data[41:]):
        assert level_file.decode(wrong, WINDOW, "key") is None
    assert level_file.decode(data, WINDOW, "another") is None
    assert level_file.decode(data, Tile(0, 0, 40, 21), "key") is None


def blocks(variance: NDArray[Any], cost: Any = 2.0, weight: Any = 1.0) -> BlockPilot:
    full = np.ones_like(variance)
    return BlockPilot(64 * full, variance, full * weight, full * cost)


def test_densities_are_the_best_that_there_are() -> None:
    """Without a uniform part the counts n minimise sum(w sigma^2 n^-theta) at a given sum(c n): no shift between two
    blocks that keeps the cost improves on them."""
    rng = np.random.default_rng(4)
    variance, cost, weight = rng.uniform(0.5, 2, (3, 6, 6))
    theta = 1.3
    pilot = blocks(variance, 1 + cost, weight)
    n = (densities(pilot, theta) - UNIFORM_SHARE) / (1 - UNIFORM_SHARE)

    def error(counts: NDArray[Any]) -> float:
        return float((weight * variance * counts**-theta).sum())

    for a, b in rng.integers(0, 36, (40, 2)):
        shifted = n.copy()
        shifted.flat[a] += 1e-3 / pilot.cost.flat[a]
        shifted.flat[b] -= 1e-3 / pilot.cost.flat[b]
        assert error(shifted) >= error(n) - 1e-12


def test_no_block_is_starved_and_none_takes_all() -> None:
    variance = np.zeros((16, 16))
    variance[3, 4] = 1.0
    density = densities(blocks(variance), 1.0)
    assert density.min() == UNIFORM_SHARE
    assert density.max() == MOST
    assert (densities(blocks(np.zeros((4, 4))), 1.0) == 1).all()


def test_an_even_picture_saves_nothing_and_an_uneven_one_what_its_densities_do() -> None:
    """Two blocks of equal cost, one of 81 times the noise, theta 1: needs are as 9 to 1, densities 1.6 and 0.4, levels 0 and 2,
    counts 1.6 and 0.4 of the mean. The error of (81 / 1.6 + 1 / 0.4) / 82 is that of an even picture at 0.648 of its
    samples."""
    assert saving_of(blocks(np.ones((1, 2))), blocks(np.ones((1, 2))), 1.2) == Saving(1.0, 1.0)
    uneven = blocks(np.array([[81.0, 1.0]]))
    found = saving_of(uneven, uneven, 1.0)
    assert found.samples == pytest.approx((81 / 1.6 + 1 / 0.4) / 82)
    assert found.cost == pytest.approx(1.0)
    dearer = blocks(np.array([[81.0, 1.0]]), cost=np.array([[4.0, 1.0]]))
    assert saving_of(uneven, dearer, 1.0).cost == pytest.approx((1.6 * 4 + 0.4 * 1) / 5)
    black = blocks(np.zeros((1, 2)))
    assert saving_of(black, black, 1.0) == Saving()


def test_a_pilots_length_is_that_at_which_it_has_enough() -> None:
    points = [_noisy(16, 0.16)]
    for even in (100, 500, 512, 1000, 5000):
        samples = 16.0
        while not pilot_suffices(samples, 1.0, StopRule(4, samples=even // 4), points):
            samples *= 2
        assert pilot_samples(even, 16) == samples


def test_a_blocks_noise_is_told_by_its_own_pilot_and_its_surroundings() -> None:
    """One block that is noisy alone keeps 0.3 + 0.7 (6/16)^2 of its standard deviation, and shares the rest by the binomial;
    what is the same everywhere stays as it is, up to the edges; blocks of which nothing is known do not count."""
    single = np.zeros((9, 9))
    single[4, 4] = 4.0
    found = np.sqrt(smoothed(blocks(single)).variance)
    assert found[4, 4] == pytest.approx(2 * (0.3 + 0.7 * (6 / 16) ** 2))
    assert found[3, 6] == pytest.approx(2 * 0.7 * (4 / 16) * (1 / 16))
    assert found[4, 7] == 0
    assert smoothed(blocks(np.full((3, 7), 2.5))).variance == pytest.approx(np.full((3, 7), 2.5))
    half = blocks(np.full((4, 8), 2.5))
    half.pixels[:, 4:] = half.variance[:, 4:] = 0
    assert smoothed(half).variance[:, :4] == pytest.approx(np.full((4, 4), 2.5))


def test_levels_are_the_nearest_in_the_logarithm() -> None:
    variance = np.random.default_rng(5).lognormal(0, 2, (11, 21))
    pilot = blocks(variance)
    density = densities(smoothed(pilot), 1.0)
    levels = error_levels(WINDOW, pilot, 1.0)
    assert levels.shape == (21, 40)
    # WINDOW begins at (5, 3): its first block is 1 wide and 1 high
    assert (np.unique(levels[1:3, 1:3]) == levels[1, 1]).all()
    assert (np.unique(levels[13:15, 35:37]) == levels[13, 35]).all()
    for y, row in ((0, 0), (1, 1), (13, 7)):
        for x, column in ((0, 0), (1, 1), (11, 6), (35, 18)):
            exact = np.log2(density.max() / density[row, column])
            assert abs(int(levels[y, x]) - exact) <= 0.5


@pytest.mark.parametrize("kept", [0, 4])
@pytest.mark.parametrize("samples", [5, 16, 33, 100])
def test_the_samples_that_are_planned_are_met_by_the_mean(samples: int, kept: int) -> None:
    """Within what one more block on the next level would change, and no block is off its level by more than one."""
    pilot = blocks(np.random.default_rng(6).lognormal(0, 2, (11, 21)))
    free = error_levels(WINDOW, pilot, 1.0)
    planned = LevelMap(WINDOW, error_levels(WINDOW, pilot, 1.0, samples, kept), kept)
    end = planned.end_for(samples)
    block = 4 * own_samples(end, 0, kept) / 2 / (21 * 40)
    assert abs(planned.mean(end) - samples) <= max(block / 2, 1e-9)
    assert planned.levels is not None
    thinned = planned.levels.astype(int) - free
    assert set(np.unique(thinned)) <= {0, 1}
    assert LevelMap(WINDOW, free, kept).mean(end) >= samples


@pytest.mark.parametrize(
    ("halfway", "whole", "theta"),
    [
        (2.0, 1.0, 1.0),
        (2**1.3, 1.0, 1.3),
        (1.0, 1.0, 1.0),
        (9.0, 1.0, 1.5),
        (0.0, 0.0, 1.25),
        (np.nan, 1.0, 1.25),
    ],
)
def test_theta_is_what_the_variance_fell_by(halfway: float, whole: float, theta: float) -> None:
    assert theta_of(halfway, whole) == pytest.approx(theta)


def _noisy(samples: float, relmse: float) -> Point:
    return Point(samples, samples / 100, relmse, relmse)


def test_a_pilot_has_enough_when_twice_as_many_were_more_than_its_part_of_the_picture() -> None:
    """Parts of 1/24, by whichever rule ends the picture first."""
    points = [_noisy(16, 0.16)]
    by_samples = StopRule(4, samples=1536 // 4)
    assert not pilot_suffices(32, 0.3, by_samples, points)
    assert pilot_suffices(64, 0.6, by_samples, points)
    # an error of 0.4 after 16 samples, at theta 1.25 without a fit: 0.05 takes 16 * 64^(1 / 1.25) = 446 samples
    assert not pilot_suffices(8, 0.2, StopRule(4, relative_error=0.05), points)
    assert pilot_suffices(16, 0.2, StopRule(4, relative_error=0.05), points)
    assert not pilot_suffices(16, 0.2, StopRule(4, relative_error=0.005), points)
    assert pilot_suffices(16, 0.2, StopRule(4, samples=16, relative_error=0.005), points)
    # 16 samples in 0.2 s
    assert not pilot_suffices(16, 0.2, StopRule(4, seconds=9.7), points)
    assert pilot_suffices(16, 0.2, StopRule(4, seconds=9.5), points)


def test_a_pilot_of_which_nothing_can_be_told_has_enough() -> None:
    assert pilot_suffices(16, 0.2, StopRule(4, relative_error=0.01), [_noisy(16, np.nan)])


def test_a_pilot_is_pooled_by_blocks_that_do_not_depend_on_tiles(samples: Any) -> None:
    make = samples()

    def pooled(size: int) -> BlockPilot:
        parts = []
        for tile in TileGrid(WINDOW, size):
            sums = make.node(tile, 0, 4).sums
            sums["rays"] = 3 * sums["taken"]
            parts.append(pixel_statistics(tile, sums))
        return pilot_of(WINDOW, parts)

    small, large = pooled(16), pooled(64)
    for name in ("pixels", "variance", "weight", "cost"):
        assert (getattr(small, name) == getattr(large, name)).all()
    assert large.pixels.sum() == 40 * 21
    assert (large.cost == 3).all()
    whole = make.node(WINDOW, 0, 4).sums
    first = pixel_statistics(WINDOW, whole)
    assert large.variance[0, 0] == pytest.approx(first.variance[:1, :1, :3].mean())
    assert large.variance[1, 1] == pytest.approx(first.variance[1:3, 1:3, :3].mean())
    block = first.mean[:13, :11, :3]
    signal = max(
        (block**2).mean() - first.variance[:13, :11, :3].mean(), (block.mean(axis=(0, 1)) ** 2).mean()
    )
    assert large.weight[0, 0] == pytest.approx(1 / (signal + EPSILON))


@pytest.mark.parametrize("uneven", [False, True])
def test_spreading_pays_where_noise_is_uneven_and_not_where_only_chance_makes_it_so(uneven: bool) -> None:
    """Uniform noise, four replicates of 2 samples: of one amplitude, and of another in a quarter of the picture."""
    window = Tile(0, 0, 64, 48)
    rng = np.random.default_rng(5)
    noise = rng.random((4, 48, 64)) + rng.random((4, 48, 64))
    if uneven:
        noise[:, :24, :32] = 1 + 0.05 * (noise[:, :24, :32] - 1)
        noise[:, 24:] = 1 + 0.2 * (noise[:, 24:] - 1)
    sums = no_sums(noise.shape)
    sums["rgba"] = noise[..., None]
    sums["taken"], sums["rays"] = 2, 6
    halves = [[pixel_statistics(window, part)] for part in (sums[:2], sums[2:])]
    assert spreading_pays(window, halves, 1.0) is uneven


def test_contrast_refines_both_sides_of_an_edge_and_nothing_else() -> None:
    rgb = np.zeros((6, 8, 3))
    rgb[:, 4:, 1] = 1.0
    levels = contrast_levels(rgb, 0.1)
    assert (levels[:, 3:5] == 0).all()
    assert (levels[:, :3] == LEVEL_NONE).all()
    assert (levels[:, 5:] == LEVEL_NONE).all()


def test_contrast_sees_diagonal_neighbours_and_the_threshold() -> None:
    rgb = np.ones((3, 3, 3))
    rgb[0, 0] = 1.5  # |a - b| / (a + b + 0.01) is 0.5 / 2.51
    assert (contrast_levels(rgb, 0.199) == 0).sum() == 4
    assert (contrast_levels(rgb, 0.2) == LEVEL_NONE).all()
    assert (contrast_levels(1e-4 * rgb, 0.05) == LEVEL_NONE).all()
