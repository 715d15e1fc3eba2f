"""Claims about cl/sampling/warp.cl: every map has the density that it states and stays in its domain."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.tables import density_table
from scipy.stats import chi2

FALSE_ALARM = 1e-6
COUNT = 1 << 18
CELLS = 24

KERNELS = """
#include "sampling/warp.cl"
__kernel void disc(__global float2 *out, const __global float2 *u) {
  out[get_global_id(0)] = square_to_disc(u[get_global_id(0)]);
}
__kernel void hemisphere(__global float4 *out, const __global float2 *u) {
  float pdf;
  const float3 d = square_to_cosine_hemisphere(u[get_global_id(0)], &pdf);
  out[get_global_id(0)] = (float4)(d, pdf);
}
__kernel void sphere(__global float4 *out, const __global float2 *u) {
  out[get_global_id(0)] = (float4)(square_to_sphere(u[get_global_id(0)]), 0.0f);
}
__kernel void cone(__global float4 *out, const __global float2 *u, const float one_minus_cos) {
  out[get_global_id(0)] = (float4)(square_to_cone(u[get_global_id(0)], one_minus_cos), 0.0f);
}
__kernel void triangle(__global float2 *out, const __global float2 *u) {
  out[get_global_id(0)] = square_to_triangle(u[get_global_id(0)]);
}
__kernel void polygon(__global float2 *out, const __global float2 *u, const uint blades,
                      const float rotation) {
  out[get_global_id(0)] = square_to_polygon(u[get_global_id(0)], blades, rotation);
}
__kernel void areas(__global float *out) {
  out[get_global_id(0)] = polygon_area((uint)get_global_id(0) + 3u);
}
__kernel void choices(__global float2 *out, const __global float *cdf, const uint count,
                      const __global float2 *u) {
  float remapped;
  const uint i = sample_cdf(cdf, count, u[get_global_id(0)].x, &remapped);
  out[get_global_id(0)] = (float2)((float)i, remapped);
}
__kernel void table(__global float2 *out, const __global float *table, const __global float2 *u) {
  float sign;
  const float x = sample_table(table, u[get_global_id(0)].x, &sign);
  out[get_global_id(0)] = (float2)(x, sign);
}
"""


@pytest.fixture(scope="module")
def warp(compiled: Any) -> Callable[..., NDArray[np.float64]]:
    """Warp(name, width, *arguments) -> (COUNT, width): images of the corners and of random points."""
    launch = compiled(KERNELS, {})
    u = (np.random.default_rng(1).integers(0, 1 << 24, (COUNT, 2)) * 2.0**-24).astype(np.float32)
    top = np.float32(1 - 2.0**-24)
    u[:4] = [[0, 0], [0, top], [top, 0], [top, top]]
    u[4] = 0.5

    def run(name: str, width: int, *before: Any, after: tuple[Any, ...] = ()) -> NDArray[np.float64]:
        out = np.empty((COUNT, width), np.float32)
        launch(name, COUNT, out, *before, u, *after)
        assert np.isfinite(out).all()
        return out.astype(np.float64)

    return run


def assert_uniform(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    """Chi-squared: (a, b) in [0, 1]^2 is uniform."""
    seen, _, _ = np.histogram2d(a, b, bins=CELLS, range=[[0, 1], [0, 1]])
    assert seen.sum() == len(a)
    expected = len(a) / CELLS**2
    assert chi2.sf(((seen - expected) ** 2 / expected).sum(), CELLS**2 - 1) > FALSE_ALARM


def turns(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.arctan2(y, x) / (2 * np.pi) % 1.0)


def test_disc_is_uniform(warp: Callable[..., NDArray[np.float64]]) -> None:
    x, y = warp("disc", 2).T
    assert (x * x + y * y).max() < 1.0
    assert_uniform(x * x + y * y, turns(x, y))


def test_hemisphere_follows_the_cosine(warp: Callable[..., NDArray[np.float64]]) -> None:
    x, y, z, pdf = warp("hemisphere", 4).T
    np.testing.assert_allclose(x * x + y * y + z * z, 1.0, atol=1e-6)
    assert z.min() > 0.0
    np.testing.assert_allclose(pdf, z / np.pi, rtol=1e-6)
    assert_uniform(np.minimum(z * z, 1.0), turns(x, y))


def test_sphere_is_uniform(warp: Callable[..., NDArray[np.float64]]) -> None:
    x, y, z, _ = warp("sphere", 4).T
    np.testing.assert_allclose(x * x + y * y + z * z, 1.0, atol=1e-6)
    assert_uniform(0.5 * (1 + z), turns(x, y))


@pytest.mark.parametrize("half_angle", [1e-4, 0.1, 1.0, 3.0])
def test_cone_is_uniform_however_narrow(warp: Callable[..., NDArray[np.float64]], half_angle: float) -> None:
    size = 2 * np.sin(half_angle / 2) ** 2
    x, y, z, _ = warp("cone", 4, after=(np.float32(size),)).T
    sine_squared = x * x + y * y
    height = np.where(z > 0, sine_squared / (1 + np.abs(z)), 1 - z)  # 1 - cos without cancellation
    assert_uniform(np.minimum(height / size, 1.0), turns(x, y))


def test_triangle_is_uniform(warp: Callable[..., NDArray[np.float64]]) -> None:
    a, b = warp("triangle", 2).T
    assert a.min() >= 0
    assert b.min() >= 0
    assert (a + b).max() <= 1.0
    # The square-root map takes the triangle back to the square, areas kept.
    rest = np.maximum(1.0 - a, 1e-12)
    assert_uniform(rest**2, np.minimum(b / rest, 1.0))


@pytest.mark.parametrize("blades", [3, 5, 6, 64])
@pytest.mark.parametrize("rotation", [0.0, 0.3, 6.2, -1.0])
def test_polygon_is_uniform(warp: Callable[..., NDArray[np.float64]], blades: int, rotation: float) -> None:
    x, y = warp("polygon", 2, after=(np.uint32(blades), np.float32(rotation))).T
    angle = (np.arctan2(y, x) - rotation) % (2 * np.pi)
    step = 2 * np.pi / blades
    side = np.floor(angle / step)
    within = angle - (side + 0.5) * step
    radius = np.hypot(x, y)
    apothem = np.cos(step / 2)
    depth = radius * np.cos(within) / apothem  # 1 on the polygon's side
    assert depth.max() < 1 + 2e-6  # corners are off by 2^-22, the apothem is at least 1/2
    # In polar form the uniform density is uniform in depth^2, in the place along the side, and in the side.
    place = 0.5 * (1 + np.tan(within) / np.tan(step / 2))
    assert_uniform(np.minimum(depth**2, 1.0), np.clip((side + place) / blades, 0.0, 1.0))


def test_polygon_area_is_that_of_its_triangles(compiled: Any) -> None:
    out = np.empty(62, np.float32)
    compiled(KERNELS, {})("areas", 62, out)
    n = np.arange(3, 65)
    np.testing.assert_allclose(out, 0.5 * n * np.sin(2 * np.pi / n), rtol=2e-6)


def test_discrete_choices_have_their_chances(warp: Callable[..., NDArray[np.float64]]) -> None:
    chances = np.array([0.0, 0.2, 0.0, 0.0, 0.5, 0.3, 0.0])
    cdf = np.concatenate([[0.0], np.cumsum(chances)]).astype(np.float32)
    cdf[-2:] = 1.0
    index, remapped = warp("choices", 2, cdf, np.uint32(len(chances))).T
    seen = np.bincount(index.astype(int), minlength=len(chances))
    assert seen[chances == 0].sum() == 0
    some = chances > 0
    expected = chances[some] * COUNT
    assert chi2.sf(((seen[some] - expected) ** 2 / expected).sum(), some.sum() - 1) > FALSE_ALARM
    assert remapped.max() < 1.0
    assert_uniform(remapped, np.random.default_rng(2).random(COUNT))


@pytest.mark.parametrize("values", [[1, 1], [0, 1], [1, 0, 0, 3], [0, 2, 1, 0], [5, 0.001, 5]])
def test_tables_follow_their_piecewise_linear_density(
    warp: Callable[..., NDArray[np.float64]], values: list[float]
) -> None:
    knots = np.linspace(0, 1, len(values))
    x, sign = warp("table", 2, density_table(knots, np.array(values, np.float64))).T
    assert x.min() >= 0.0
    assert x.max() <= 1.0
    np.testing.assert_array_equal(sign, 1.0)
    fine = np.linspace(0, 1, 4801)
    density = np.interp(fine, knots, values)
    cdf = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    u = np.interp(x, fine, cdf / cdf[-1])
    assert_uniform(u, np.random.default_rng(2).random(COUNT))
