"""Claims about what samplers are made of: uniform numbers, permutations, Sobol matrices, Owen scrambling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm, qmc

FALSE_ALARM = 1e-6

KERNELS = """
#include "sampling/strata.cl"
#include "sampling/owen.cl"
__kernel void permuted(__global uint *out, const uint count) {
  const uint i = get_global_id(0);
  out[i] = permute(i % count, count, mix64(i / count));
}
__kernel void sobol_points(__global uint2 *out, const __global uint *index) {
  const uint i = get_global_id(0);
  out[i] = (uint2)(REVERSE_BITS(index[i]), REVERSE_BITS(pascal_reversed(index[i])));
}
__kernel void scrambled(__global uint *out, const __global uint *x, const __global uint *seed) {
  const uint i = get_global_id(0);
  out[i] = owen_scramble(x[i], seed[i]);
}
__kernel void roots(__global uint *out, const __global uint *n) {
  out[get_global_id(0)] = nearest_root(n[get_global_id(0)]);
}
"""


@pytest.fixture(scope="module")
def launch(compiled: Any) -> Callable[..., None]:
    return compiled(KERNELS, {})  # type: ignore[no-any-return]


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 13, 1000, 1 << 20])
def test_permutations_are_bijective(launch: Callable[..., None], count: int) -> None:
    keys = max(20_000 // count, 1)
    out = np.empty(keys * count, np.uint32)
    launch("permuted", len(out), out, np.uint32(count))
    assert (np.sort(out.reshape(keys, count), axis=1) == np.arange(count)).all()


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8, 16, 17, 25, 32])
def test_every_pair_of_places_is_as_likely(launch: Callable[..., None], count: int) -> None:
    """Two elements of a permutation land on each ordered pair of places with one chance: padded dimensions
    are then uncorrelated, and the spread of replicates is that of their mean."""
    keys = 1_000_000 // count
    out = np.empty((keys, count), np.uint32)
    launch("permuted", out.size, out, np.uint32(count))
    worst = 1.0
    pairs = [(i, j) for i in range(count) for j in range(i)]
    for i, j in pairs:
        seen = np.bincount(out[:, i] * count + out[:, j], minlength=count * count)
        expected = keys / (count * (count - 1))
        possible = ~np.eye(count, dtype=bool).reshape(-1)
        assert seen[~possible].sum() == 0
        statistic = ((seen[possible] - expected) ** 2 / expected).sum()
        worst = min(worst, float(chi2.sf(statistic, count * (count - 1) - 1)))
    assert worst > FALSE_ALARM / len(pairs)


def test_both_dimensions_are_sobols(launch: Callable[..., None]) -> None:
    index = np.arange(4096, dtype=np.uint32)
    out = np.empty((4096, 2), np.uint32)
    launch("sobol_points", len(index), out, index)
    # SciPy draws them in Gray code order: the same points.
    expected = qmc.Sobol(2, scramble=False, bits=32).random(4096)
    got = out / 2.0**32
    gray = index ^ (index >> 1)
    np.testing.assert_array_equal(got[gray], expected)


def common_prefix(a: NDArray[np.uint32], b: NDArray[np.uint32]) -> NDArray[np.int64]:
    """How many leading bits agree."""
    different = (a ^ b).astype(np.float64)
    return np.where(different > 0, 32 - np.frexp(different)[1], 32)


def test_scrambling_is_nested(launch: Callable[..., None]) -> None:
    """Owen 1995: numbers agree in exactly as many leading bits after scrambling as before."""
    rng = np.random.default_rng(3)
    a = rng.integers(0, 1 << 32, 100_000, dtype=np.uint32)
    b = a ^ (
        rng.integers(1 << 31, 1 << 32, len(a), dtype=np.uint32)
        >> rng.integers(0, 32, len(a), dtype=np.uint32)
    )
    seeds = rng.integers(0, 1 << 32, len(a), dtype=np.uint32)
    out = [np.empty(len(a), np.uint32) for _ in range(2)]
    launch("scrambled", len(a), out[0], a, seeds)
    launch("scrambled", len(a), out[1], b, seeds)
    np.testing.assert_array_equal(common_prefix(*out), common_prefix(a, b))


def test_scrambled_numbers_are_uniform_over_seeds(launch: Callable[..., None]) -> None:
    rng = np.random.default_rng(4)
    seeds = rng.integers(0, 1 << 32, 1 << 16, dtype=np.uint32)
    out = np.empty(len(seeds), np.uint32)
    for x in (0, 1, 1 << 31, 0xFFFFFFFF, 0x12345678):
        launch("scrambled", len(seeds), out, np.full(len(seeds), x, np.uint32), seeds)
        seen = np.bincount(out >> 24, minlength=256)
        statistic = ((seen - 256.0) ** 2 / 256.0).sum()
        assert chi2.sf(statistic, 255) > FALSE_ALARM / 5


def nested_uniform(x: NDArray[np.uint32], rng: np.random.Generator) -> NDArray[np.uint32]:
    """Owen's scrambling by its definition: a coin for each interval says whether its halves change places. x: a row of
    numbers a scrambling, all rows alike; digits behind the 16th are random anew."""
    order = np.argsort(x[0])
    low = rng.integers(0, 1 << 16, x.shape, dtype=np.uint32)
    out = np.zeros_like(x)
    for bit in range(16):
        above = x[0].astype(np.uint64) >> np.uint64(32 - bit)
        _, interval = np.unique(above[order], return_inverse=True)
        coins = rng.integers(0, 2, (len(x), interval.max() + 1), dtype=np.uint32)
        flips = np.empty_like(x)
        flips[:, order] = coins[:, interval]
        out |= ((x >> np.uint32(31 - bit) & np.uint32(1)) ^ flips) << np.uint32(31 - bit)
    return np.asarray(out | low)


@pytest.mark.parametrize("count", [8, 32])
def test_hashed_scrambling_varies_as_nested_uniform_scrambling(
    launch: Callable[..., None], count: int
) -> None:
    """The variance of means over a scrambled net is that of Owen's scrambling, for smooth and sharp integrands."""
    rng = np.random.default_rng(12)
    rows = 40_000
    net = (qmc.Sobol(2, scramble=False, bits=32).random(count) * 2.0**32).astype(np.uint32)
    hashed, nested = [], []
    for axis in range(2):
        x = np.ascontiguousarray(np.broadcast_to(net[:, axis], (rows, count)))
        seeds = np.repeat(rng.integers(0, 1 << 32, rows, dtype=np.uint32), count)
        out = np.empty_like(x)
        launch("scrambled", x.size, out, x, seeds)
        hashed.append(out / 2.0**32)
        nested.append(nested_uniform(x, rng) / 2.0**32)
    for f in (
        lambda x, y: np.sin(3 * x) * np.exp(y),
        lambda x, y: (x - 0.5) * (y - 0.5),
        lambda x, y: np.exp(-40 * ((x - 0.3) ** 2 + (y - 0.3) ** 2)),
        lambda x, y: (0.7 * x + 0.71 * y < 0.6) * 1.0,
        lambda x, y: ((x - 0.4) ** 2 + (y - 0.6) ** 2 < 0.1) * 1.0,
    ):
        means = [f(*points).mean(axis=1) for points in (hashed, nested)]
        deviations = [m - m.mean() for m in means]
        variances = [float((d**2).mean()) for d in deviations]
        errors = [float((d**2).std()) / np.sqrt(rows) / v for d, v in zip(deviations, variances, strict=True)]
        assert abs(np.log(variances[0] / variances[1])) < norm.isf(FALSE_ALARM / 20) * np.hypot(*errors)


def test_rows_are_the_nearest_square_root(launch: Callable[..., None]) -> None:
    around = (np.arange(1, 4096, dtype=np.int64) ** 2)[:, None] + [-1, 0, 1]
    halves = around[:, 1] + np.arange(1, 4096)
    n = np.concatenate([around.reshape(-1)[1:], halves, halves + 1, [1 << 24]]).astype(np.uint32)
    out = np.empty(len(n), np.uint32)
    launch("roots", len(n), out, n)
    np.testing.assert_array_equal(out, np.floor(np.sqrt(n.astype(np.float64)) + 0.5))
