"""Claims about what samplers are made of: uniform numbers, permutations, Sobol matrices, Owen scrambling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, qmc

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


def test_rows_are_the_nearest_square_root(launch: Callable[..., None]) -> None:
    around = (np.arange(1, 4096, dtype=np.int64) ** 2)[:, None] + [-1, 0, 1]
    halves = around[:, 1] + np.arange(1, 4096)
    n = np.concatenate([around.reshape(-1)[1:], halves, halves + 1, [1 << 24]]).astype(np.uint32)
    out = np.empty(len(n), np.uint32)
    launch("roots", len(n), out, n)
    np.testing.assert_array_equal(out, np.floor(np.sqrt(n.astype(np.float64)) + 0.5))
