"""Claims about reconstruction filters: samples follow them, and weighted means are the filtered picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.filters import compile_filter, profile_of
from penumbra_kernels.device import Device
from penumbra_scene.film import Film
from scipy.integrate import quad

KERNELS = """
#include "film/filter.cl"
__kernel void offsets(__global float4 *out, const __global float *table, const float radius,
                      const __global float2 *u) {
  float weight;
  const float2 offset = filter_sample(table, radius, u[get_global_id(0)], &weight);
  out[get_global_id(0)] = (float4)(offset, weight, 0.0f);
}
"""
# Filter positions of sixteen lanes, and of each alone; every fifth lane is off and leaves zeros.
LANES = """
#include "film/filter.cl"
#include "camera/camera16.cl"
__kernel void both(__global float4 *out, const __global float *table, const float radius, const __global float2 *u) {
  const uint first = LANES * (uint)get_global_id(0);
  float16 ux, uy, x, y, weight;
  Mask16 on;
  for (uint k = 0u; k < LANES; k++) {
    LANE_F(ux, k) = u[first + k].x;
    LANE_F(uy, k) = u[first + k].y;
    LANE_I(on, k) = (first + k) % 5u == 4u ? 0 : -1;
  }
  filter_sample16(table, radius, ux, uy, on, &x, &y, &weight);
  for (uint k = 0u; k < LANES; k++) {
    out[2u * (first + k)] = out[2u * (first + k) + 1u] = (float4)(0.0f);
    if (!LANE_I(on, k)) continue;
    float alone;
    const float2 offset = filter_sample(table, radius, u[first + k], &alone);
    out[2u * (first + k)] = (float4)(LANE_F(x, k), LANE_F(y, k), LANE_F(weight, k), 1.0f);
    out[2u * (first + k) + 1u] = (float4)(offset, alone, 1.0f);
  }
}
"""
COUNT = 1 << 16

FILTERS: dict[str, dict[str, Any]] = {
    "box": {"type": "box"},
    "wide box": {"type": "box", "radius": 3.0},
    "tent": {"type": "tent"},
    "gaussian": {"type": "gaussian"},
    "sharp gaussian": {"type": "gaussian", "stddev": 1e-3, "radius": 8},
    "flat gaussian": {"type": "gaussian", "stddev": 16, "radius": 0.25},
    "mitchell": {"type": "mitchell"},
    "catmull-rom": {"type": "mitchell", "b": 0, "c": 0.5},
    "sharpest mitchell": {"type": "mitchell", "b": 0, "c": 1, "radius": 1.0},
    "b-spline": {"type": "mitchell", "b": 1, "c": 0},
    "blackman-harris": {"type": "blackman_harris"},
}

Offsets = Callable[[Any, NDArray[np.float32]], NDArray[np.float64]]


@pytest.fixture(scope="module")
def offsets(compiled: Any) -> Offsets:
    launch = compiled(KERNELS, {})

    def run(model: Any, u: NDArray[np.float32]) -> NDArray[np.float64]:
        out = np.empty((len(u), 4), np.float32)
        launch("offsets", len(u), out, compile_filter(model), np.float32(model.radius), u)
        return out[:, :3].astype(np.float64)

    return run


def model_of(name: str) -> Any:
    return Film.model_validate({"filter": FILTERS[name]}).filter


def even(count: int) -> NDArray[np.float32]:
    """Midpoints along x, y at 0.37."""
    u = np.full((count, 2), 0.37, np.float32)
    u[:, 0] = (np.arange(count) + 0.5) / count
    return u


def integral(model: Any, weigh: Callable[[float], float], end: float = 1.0) -> float:
    """Of the profile times `weigh` over [0, end], in units of the radius."""
    profile = profile_of(model)
    stop = min(end, 9 * model.stddev / model.radius) if model.type == "gaussian" else end
    points = [p for p in (0.25, 0.5, 0.75) if p < stop]
    value, _ = quad(
        lambda x: float(profile(np.array(x))) * weigh(x), 0.0, stop, points=points, epsabs=1e-13, limit=200
    )
    return float(value)


@pytest.mark.parametrize("name", FILTERS)
def test_positions_follow_the_filters_absolute_value(offsets: Offsets, name: str) -> None:
    """The analytic CDF of |f| takes samples at even u back to even u."""
    model = model_of(name)
    u = even(4096)
    x = offsets(model, u)[:, 0] / model.radius
    assert (np.diff(x) >= 0).all()
    np.testing.assert_allclose(x, -x[::-1], atol=2e-6 * max(1.0, np.abs(x).max()))
    assert np.abs(x).max() <= 1.0
    profile = profile_of(model)
    end = min(1.0, 9 * model.stddev / model.radius) if model.type == "gaussian" else 1.0
    fine = np.linspace(0, end, 200_001)
    values = np.abs(profile(fine))
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))])
    expected = np.interp(np.abs(x), fine, cdf / cdf[-1])
    # Straight lines within cells whose CDF is exact at both ends: third order in the cell's width.
    np.testing.assert_allclose(expected, np.abs(2.0 * u[:, 0].astype(np.float64) - 1.0), atol=2e-6)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("power", [0, 2, 4])
def test_weighted_means_are_the_filtered_picture(offsets: Offsets, name: str, power: int) -> None:
    """Moments, negative lobes included: the mean of weight x^p is integral(f x^p) / integral(f)."""
    model = model_of(name)
    got = offsets(model, even(COUNT))
    flipped = offsets(model, even(COUNT)[:, ::-1].copy())
    np.testing.assert_array_equal(got[:, 0], flipped[:, 1])
    centre = got[COUNT // 2, 2]  # where x's factor of the weight is positive
    weight = got[:, 2] / centre * np.sqrt(np.abs(centre))
    mean = (weight * (got[:, 0] / model.radius) ** power).mean()
    expected = integral(model, lambda x: x**power) / integral(model, lambda x: 1.0)
    # The weight jumps from -w to w at two places, each of which may lie anywhere between two samples.
    jump = 2 * np.abs(weight).max() / COUNT if weight.min() < 0 else 0.0
    assert mean == pytest.approx(expected, abs=5e-6 + jump)


@pytest.mark.parametrize("name", ["box", "tent", "gaussian", "b-spline", "blackman-harris"])
def test_filters_without_negative_lobes_weigh_one(offsets: Offsets, name: str) -> None:
    np.testing.assert_array_equal(offsets(model_of(name), even(1000))[:, 2], 1.0)


def test_mitchell_weighs_two_dimensions_at_once(offsets: Offsets) -> None:
    u = (np.random.default_rng(1).random((1 << 18, 2))).astype(np.float32)
    x, y, weight = offsets(model_of("mitchell"), u).T
    positive = integral(model_of("mitchell"), lambda t: 1.0, 1.0)
    assert positive == pytest.approx(0.25)  # the filter integrates to 1 over its four units
    deviation = weight.std() / np.sqrt(len(weight))
    assert abs(weight.mean() - 1.0) < 5 * deviation
    value = weight * (1 + x * x) * (2 + y * y)
    moment = (
        4 * integral(model_of("mitchell"), lambda t: t * t) / integral(model_of("mitchell"), lambda t: 1.0)
    )
    assert abs(value.mean() - (1 + moment) * (2 + moment)) < 5 * value.std() / np.sqrt(len(value))


def test_the_box_maps_straight(offsets: Offsets) -> None:
    u = np.float32([[0.5, 0.5], [0, 0.25], [0.75, 1 - 2**-24]])
    got = offsets(model_of("box"), u)
    np.testing.assert_array_equal(got[:, :2], np.float32(u.astype(np.float64) - 0.5))


@pytest.fixture(
    scope="module", params=[{}, {"PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0}], ids=["native", "portable"]
)
def lanes(request: pytest.FixtureRequest, compiled: Any, device: Device) -> Any:
    return compiled(LANES, {**device.flags, **request.param})


@pytest.mark.parametrize("name", FILTERS)
def test_each_lane_is_what_one_gives(lanes: Any, name: str) -> None:
    """Also at the bounds of cells and next to them, where the search must not be off by one."""
    model = model_of(name)
    table = compile_filter(model)
    u = np.random.default_rng(9).random((COUNT, 2), np.float32)
    cdf = table[2 + 2 :: 6][: int(table[0])]
    bounds = np.concatenate([0.5 + 0.5 * cdf, 0.5 - 0.5 * cdf])
    edges = np.concatenate(
        [bounds, np.nextafter(bounds, np.float32(2)), np.nextafter(bounds, np.float32(-1))]
    )
    edges = np.clip(edges, 0.0, 1.0 - 2.0**-24).astype(np.float32)
    u[: len(edges), 0] = u[len(edges) : 2 * len(edges), 1] = edges
    out = np.zeros((COUNT, 2, 4), np.float32)
    lanes("both", COUNT // 16, out, table, np.float32(model.radius), u)
    assert (out[:, 0].view(np.uint32) == out[:, 1].view(np.uint32)).all()
    assert out[:, 0, 3].sum() > 0.79 * COUNT
    assert len(np.unique(out[:, 0, 0])) > 1000
