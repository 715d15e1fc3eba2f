"""Claims about the samplers: uniform, stratified and independent as promised, at any index and dimension."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.layout import CONSTANTS, PARAMS
from scipy.stats import chi2, kstest, norm

FALSE_ALARM = 1e-6
Z = float(norm.isf(FALSE_ALARM / 2))

KERNELS = """
#include "sampling/sampler.cl"
// keys: pixel (x, y << 32), replicate, index, dimension.
__kernel void draw_1d(__global float *out, const __global Params *params, const __global ulong *keys,
                      const uint m) {
  const uint i = get_global_id(0);
  const __global ulong *k = keys + 4 * i;
  Sampler s = sampler_start(params, (uint)k[0], (uint)(k[0] >> 32), (uint)k[1]);
  sampler_next(&s, m ? k[2] / m : k[2]);
  out[i] = m ? sample_1d_of(&s, k[3], (uint)(k[2] % m), m) : sample_1d(&s, k[3]);
}
__kernel void draw_2d(__global float2 *out, const __global Params *params, const __global ulong *keys,
                      const uint m) {
  const uint i = get_global_id(0);
  const __global ulong *k = keys + 4 * i;
  Sampler s = sampler_start(params, (uint)k[0], (uint)(k[0] >> 32), (uint)k[1]);
  sampler_next(&s, m ? k[2] / m : k[2]);
  out[i] = m ? sample_2d_of(&s, k[3], (uint)(k[2] % m), m) : sample_2d(&s, k[3]);
}
"""

STOCHASTIC = ["random", "independent", "stratified", "jittered", "sobol", "blue_noise"]
PIXEL, LENS, TIME = 0, 1, 2


def bounce(number: int, slot: int, light: int = -1) -> int:
    """The dimension's number, as base/dimensions.h makes it."""
    return (number + 1) * 16 + slot + ((light + 1) << 32)


@dataclass(frozen=True)
class Draw:
    """A sampler on a device, with launch parameters."""

    launch: Callable[..., None]
    name: str

    def __call__(
        self,
        side: int,
        dimension: Any,
        index: Any = 0,
        x: Any = 0,
        y: Any = 0,
        replicate: Any = 0,
        *,
        m: int = 0,
        strata: int = 0,
        seed: int = 0,
        replicates: int = 1,
        film: int = 64,
    ) -> NDArray[np.float32]:
        """Points for all keys, broadcast against each other: shape (...) for side 1, (..., 2) for side 2."""
        shape = np.broadcast_shapes(*(np.shape(v) for v in (x, y, replicate, index, dimension)))
        pixel = np.asarray(x, np.uint64) | (np.asarray(y, np.uint64) << np.uint64(32))
        columns = [
            np.broadcast_to(np.asarray(v, np.uint64), shape) for v in (pixel, replicate, index, dimension)
        ]
        keys = np.stack(columns, axis=-1).reshape(-1, 4)
        params = np.zeros((), PARAMS)
        params["seed"], params["strata"], params["replicate_count"] = seed, strata, replicates
        params["film_width"] = params["film_height"] = film
        params["log2_samples"] = (strata - 1).bit_length() if strata else 32
        out = np.empty((len(keys), 2) if side == 2 else len(keys), np.float32)
        self.launch(f"draw_{side}d", len(keys), out, params, keys, np.uint32(m))
        return out.reshape((*shape, 2) if side == 2 else shape)


@pytest.fixture(scope="session")
def samplers(compiled: Any) -> Callable[[str], Draw]:
    made: dict[str, Draw] = {}

    def get(name: str) -> Draw:
        if name not in made:
            flags = {"PENUMBRA_SAMPLER": CONSTANTS[f"SAMPLER_{name.upper()}"]}
            made[name] = Draw(compiled(KERNELS, flags), name)
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


@pytest.mark.parametrize("name", STOCHASTIC)
def test_neighbours_in_every_key_are_uncorrelated(samplers: Any, name: str) -> None:
    """Pixel, replicate, seed, dimension; and the two coordinates of a point."""
    draw = samplers(name)
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    base = draw(2, bounce(0, 3), 5, x, y, 1, seed=7, strata=16, film=256)
    others = {
        "replicate": draw(2, bounce(0, 3), 5, x, y, 2, seed=7, strata=16, film=256),
        "seed": draw(2, bounce(0, 3), 5, x, y, 1, seed=8, strata=16, film=256),
        "dimension": draw(2, bounce(0, 4), 5, x, y, 1, seed=7, strata=16, film=256),
        "bounce": draw(2, bounce(1, 3), 5, x, y, 1, seed=7, strata=16, film=256),
        "coordinates": base[..., ::-1],
    }
    if name != "blue_noise":  # where neighbouring pixels are meant to be complementary
        others["pixel"] = draw(2, bounce(0, 3), 5, x + 1, y, 1, seed=7, strata=16, film=256)
    for what, other in others.items():
        for axis in (0, 1):
            r = np.corrcoef(base[..., axis].reshape(-1), other[..., axis].reshape(-1))[0, 1]
            assert abs(r) < Z / np.sqrt(x.size), what


@pytest.mark.parametrize("name", ["independent", "jittered", "sobol", "blue_noise"])
def test_indices_and_pixels_do_not_wrap(samplers: Any, name: str) -> None:
    """64-bit indices, pictures of 32768 pixels a side."""
    draw = samplers(name)
    index = np.array([0, 1, 2**32 - 1, 2**32, 2**32 + 1, 3840 * 2160 * 1024, 2**40, 2**62], np.uint64)
    points = draw(2, LENS, index, film=32768)
    assert len(np.unique(points, axis=0)) == len(index)
    assert points.min() >= 0
    assert points.max() < 1
    x = np.array([0, 1, 32766, 32767, 0, 32767])
    y = np.array([0, 0, 0, 0, 32767, 32767])
    far = draw(2, LENS, 0, x, y, film=32768, strata=16)
    assert len(np.unique(far, axis=0)) == len(x)


def eight_dimensions(draw: Draw, index: Any, x: Any, replicate: Any, **keys: Any) -> NDArray[np.float64]:
    """Four padded pairs: (..., 8)."""
    names = (PIXEL if draw.name != "stratified" else bounce(2, 3), LENS, bounce(0, 1), bounce(0, 3))
    parts = [draw(2, d, index, x, 0, replicate, **keys) for d in names]
    return np.concatenate(parts, axis=-1).astype(np.float64)


INTEGRANDS: dict[str, tuple[Callable[[NDArray[np.float64]], NDArray[np.float64]], float]] = {
    "1-D": (lambda u: np.exp(u[..., 0]), np.e - 1),
    "2-D edge": (lambda u: (u[..., 0] + 0.7 * u[..., 1] < 0.6).astype(np.float64), 0.6 * 0.6 / 1.4),
    "8-D smooth": (lambda u: np.prod(1 + 0.8 * (2 * u - 1), axis=-1), 1.0),
    "8-D edge": (lambda u: (u.sum(axis=-1) < 4).astype(np.float64), 0.5),
}


@pytest.mark.parametrize("name", STOCHASTIC)
def test_spread_of_replicates_is_the_variance_of_their_mean(samplers: Any, name: str) -> None:
    """Pooled estimated / true variance within 0.9-1.1 in 1, 2 and 8 dimensions."""
    pixels, replicates, count = 6000, 4, 8
    i, r, x = np.meshgrid(np.arange(count), np.arange(replicates), np.arange(pixels), indexing="ij")
    points = eight_dimensions(samplers(name), i, x, r, strata=count, film=8192)
    for what, (function, truth) in INTEGRANDS.items():
        means = function(points).mean(axis=0)
        mean = means.mean(axis=0)
        estimated = means.var(axis=0, ddof=1).mean() / replicates
        true = ((mean - truth) ** 2).mean()
        # 6,000 pixels: both together vary by about sqrt(2 / 6000 + 2 / 18000) = 2.1 %, kurtosis adds little.
        assert 0.9 < estimated / true < 1.1, what
        if name != "blue_noise":
            assert abs((mean - truth).mean()) < Z * np.sqrt(true / pixels), what


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


@pytest.mark.parametrize("name", ["jittered", "sobol", "blue_noise"])
def test_a_product_over_far_dimensions_has_its_mean(samplers: Any, name: str) -> None:
    """No dimension is the last, and no two are the same."""
    draw = samplers(name)
    x, i = np.meshgrid(np.arange(4000), np.arange(16))
    value = np.ones(x.shape)
    for k in (0, 1, 1000, 30000, 65535):
        value = value * 4 * np.prod(draw(2, bounce(k, 3), i, x, strata=16, film=4096), axis=-1)
    means = value.mean(axis=0)
    # Pixels of blue noise are not independent, but their means' sum varies less than if they were.
    assert abs(means.mean() - 1) < Z * means.std() / np.sqrt(means.size)


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
