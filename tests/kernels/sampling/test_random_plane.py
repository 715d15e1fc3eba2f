"""Claims about the `random` sampler's counts: multinomial over the film, however it is cut into tiles."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sampling.random_plane import binomial, counts
from scipy.special import gammaln
from scipy.stats import chi2

FALSE_ALARM = 1e-6


def test_counts_add_up_to_the_films_pixels() -> None:
    got = counts(3, 37, 23, Tile(0, 0, 37, 23), 2, 5, 8)
    np.testing.assert_array_equal(got.sum(axis=(2, 3), dtype=np.int64), 37 * 23)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 9), (2, 1), (3, 3)])
def test_small_films(width: int, height: int) -> None:
    got = counts(1, width, height, Tile(0, 0, width, height), 1, 0, 50)
    np.testing.assert_array_equal(got.sum(axis=(2, 3)), width * height)


@pytest.mark.parametrize("side", [1, 7, 16])
def test_any_tile_gets_the_same_counts(side: int) -> None:
    whole = counts(9, 40, 30, Tile(0, 0, 40, 30), 2, 0, 4)
    corners = [(x, y) for y in range(0, 30, side) for x in range(0, 40, side)]
    for x, y in corners[:: 37 if side == 1 else 1]:
        tile = Tile(x, y, min(side, 40 - x), min(side, 30 - y))
        part = counts(9, 40, 30, tile, 2, 2, 1)
        expected = whole[:, 2:3, y : y + tile.height, x : x + tile.width]
        np.testing.assert_array_equal(part, expected)


def test_keys_matter() -> None:
    tile = Tile(0, 0, 16, 16)
    base = counts(1, 16, 16, tile, 2, 0, 2)
    assert not np.array_equal(base[0], base[1])
    assert not np.array_equal(base[:, 0], base[:, 1])
    assert not np.array_equal(base, counts(2, 16, 16, tile, 2, 0, 2))
    assert not np.array_equal(base, counts(1, 16, 16, tile, 2, 1 << 32, 2))


def test_a_pixels_count_is_binomial() -> None:
    width, height = 13, 6
    total = width * height
    got = counts(4, width, height, Tile(0, 0, width, height), 4, 0, 5000).reshape(-1, total)
    k = np.arange(total + 1)
    log_pmf = gammaln(total + 1) - gammaln(k + 1) - gammaln(total - k + 1)
    pmf = np.exp(log_pmf + k * np.log(1 / total) + (total - k) * np.log1p(-1 / total))
    cells = 5  # 0, 1, 2, 3, more
    expected = np.append(pmf[: cells - 1], pmf[cells - 1 :].sum()) * len(got)
    for pixel in range(0, total, 11):
        seen = np.bincount(np.minimum(got[:, pixel], cells - 1), minlength=cells)
        statistic = ((seen - expected) ** 2 / expected).sum()
        assert chi2.sf(statistic, cells - 1) > FALSE_ALARM / 8


def test_pixels_are_as_little_correlated_as_a_multinomial() -> None:
    total = 64
    got = counts(5, 8, 8, Tile(0, 0, 8, 8), 4, 0, 5000).reshape(-1, total).astype(np.float64)
    correlation = np.corrcoef(got.T)
    off = correlation[~np.eye(total, dtype=bool)]
    # 2,016 pairs, each -1/63 up to 1/sqrt(20000): 6.5 deviations keep the false alarm below 1e-6.
    assert np.abs(off + 1 / (total - 1)).max() < 6.5 / np.sqrt(len(got))


@pytest.mark.parametrize(
    ("n", "share"), [(1, 0.5), (7, 0.5), (40, 0.5), (1000, 0.5), (5000, 0.5), (9, 2 / 3), (300, 0.8)]
)
def test_binomial_has_the_right_mean_and_variance(n: int, share: float) -> None:
    u = (np.arange(20_000) + 0.5) / 20_000
    got = binomial(np.full(len(u), n), np.full(len(u), share), u)
    assert (np.diff(got) >= 0).all()
    deviation = np.sqrt(n * share * (1 - share))
    # Midpoint rule over a step function: each of at most n + 1 steps is off by at most half a cell.
    assert abs(got.mean() - n * share) <= deviation * 20 / np.sqrt(len(u)) / 10
    assert abs(got.var() / deviation**2 - 1) < 0.01


def test_nothing_splits_into_nothing() -> None:
    np.testing.assert_array_equal(
        binomial(np.zeros(2, np.int64), np.array([0.5, 0.3]), np.array([0.9, 0.9])), 0
    )
