"""Claims about cl/base/transcendental.cl: errors in units in the last place against float64."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

KERNELS = '#include "base/transcendental.cl"\n' + "".join(
    f"__kernel void {name}(__global float *out, const __global float *a, const __global float *b) {{\n"
    f"  const uint i = get_global_id(0);\n  out[i] = {call};\n}}\n"
    for name, call in {
        "exponential": "exp_f(a[i])",
        "logarithm": "log_f(a[i])",
        "power": "pow_f(a[i], b[i])",
        "arcsine": "asin_f(a[i])",
        "arccosine": "acos_f(a[i])",
        "angle": "atan2_f(a[i], b[i])",
    }.items()
)
COUNT = 1 << 20
FLOATS = NDArray[np.float32]


@pytest.fixture(scope="module")
def evaluate(compiled: Any) -> Callable[..., FLOATS]:
    launch = compiled(KERNELS, {})

    def call(name: str, a: FLOATS, b: FLOATS | None = None) -> FLOATS:
        out = np.empty(len(a), np.float32)
        launch(name, len(a), out, a, a if b is None else b)
        return out

    return call


def ulps(got: FLOATS, exact: NDArray[np.float64]) -> NDArray[np.float64]:
    """Error in ulps of the exact result; below the normal range in those of the smallest normal number."""
    unit = np.spacing(np.maximum(np.abs(exact), 2.0**-126).astype(np.float32)).astype(np.float64)
    return np.abs(got.astype(np.float64) - exact) / unit


def positive_floats(rng: np.random.Generator, low: float, high: float) -> FLOATS:
    """Uniform over representations: every exponent gets its share."""
    a, b = np.float32([low, high]).view(np.uint32)
    return rng.integers(a, int(b) + 1, COUNT, dtype=np.uint32).view(np.float32)


def test_exp_is_good_to_1_1_ulp(evaluate: Callable[..., FLOATS]) -> None:
    x = np.random.default_rng(1).uniform(-103, 88.72, COUNT).astype(np.float32)
    small = positive_floats(np.random.default_rng(2), 1e-30, 80.0)
    for a in (x, small, -small):
        assert ulps(evaluate("exponential", a), np.exp(a.astype(np.float64))).max() <= 1.1


def test_exp_at_its_limits(evaluate: Callable[..., FLOATS]) -> None:
    got = evaluate("exponential", np.float32([0, -np.inf, np.inf, -200, 200, np.nan]))
    np.testing.assert_array_equal(got, np.float32([1, 0, np.inf, 0, np.inf, np.nan]))


def test_log_is_good_to_1_ulp(evaluate: Callable[..., FLOATS]) -> None:
    rng = np.random.default_rng(3)
    for a in (positive_floats(rng, 1.2e-38, 3.4e38), rng.uniform(0.5, 2, COUNT).astype(np.float32)):
        assert ulps(evaluate("logarithm", a), np.log(a.astype(np.float64))).max() <= 1.0


def test_log_at_its_limits(evaluate: Callable[..., FLOATS]) -> None:
    got = evaluate("logarithm", np.float32([0, 1, -1, np.inf, np.nan]))
    np.testing.assert_array_equal(got, np.float32([-np.inf, 0, np.nan, np.inf, np.nan]))


@pytest.mark.parametrize("exponent", [1e-3, 0.5, 2.2, 50.0, 1e4, 1e6])
def test_pow_is_good_to_2_2_ulp_at_every_exponent(evaluate: Callable[..., FLOATS], exponent: float) -> None:
    rng = np.random.default_rng(4)
    base = np.exp(rng.uniform(-80 / exponent, 0, COUNT).clip(-80, 80)).astype(np.float32)
    y = np.full(COUNT, exponent, np.float32)
    exact = np.power(base.astype(np.float64), y.astype(np.float64))
    keep = exact > 2.0**-126
    assert keep.mean() > 0.5
    assert ulps(evaluate("power", base, y), exact)[keep].max() <= 2.2


def test_pow_at_its_limits(evaluate: Callable[..., FLOATS]) -> None:
    got = evaluate("power", np.float32([0, 0, 0, 2, 0.5, 1, 1e30]), np.float32([0, 2, -1, 1e9, 1e9, 1e30, 0]))
    np.testing.assert_array_equal(got, np.float32([1, 0, np.inf, np.inf, 0, 1, 1]))


@pytest.mark.parametrize(
    ("name", "exact", "bound"), [("arcsine", np.arcsin, 2.5), ("arccosine", np.arccos, 2.0)]
)
def test_arc_functions_keep_their_bounds(
    evaluate: Callable[..., FLOATS], name: str, exact: Any, bound: float
) -> None:
    rng = np.random.default_rng(5)
    near_one = (1.0 - positive_floats(rng, 6e-8, 0.5)).astype(np.float32)
    for a in (
        rng.uniform(-1, 1, COUNT).astype(np.float32),
        near_one,
        -near_one,
        positive_floats(rng, 1e-30, 1),
    ):
        assert ulps(evaluate(name, a), exact(a.astype(np.float64))).max() <= bound


def test_arc_functions_clamp(evaluate: Callable[..., FLOATS]) -> None:
    beyond = np.float32([1, 1.0000001, -1.0000001, 5])
    np.testing.assert_array_equal(evaluate("arccosine", beyond), np.float32([0, 0, np.pi, 0]))
    np.testing.assert_array_equal(
        evaluate("arcsine", beyond), np.float32(np.pi / 2) * np.float32([1, 1, -1, 1])
    )


def test_atan2_is_good_to_3_ulp(evaluate: Callable[..., FLOATS]) -> None:
    rng = np.random.default_rng(6)
    wide = [positive_floats(rng, 1e-15, 1e15) * rng.choice(np.float32([-1, 1]), COUNT) for _ in range(2)]
    near = [rng.normal(size=COUNT).astype(np.float32) for _ in range(2)]
    for y, x in (wide, near):
        assert (
            ulps(evaluate("angle", y, x), np.arctan2(y.astype(np.float64), x.astype(np.float64))).max() <= 3.0
        )


def test_atan2_on_the_axes(evaluate: Callable[..., FLOATS]) -> None:
    y, x = np.float32([0, 0, 1, -1, -0.0, 0]), np.float32([0, 1, 0, 0, -1, -1])
    expected = np.arctan2(y, x)
    np.testing.assert_array_equal(evaluate("angle", y, x), expected)
