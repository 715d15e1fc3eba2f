"""Reconstruction filters as tables for cl/film/filter.cl: half of one axis, in units of the radius."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.film import (
    BlackmanHarrisFilter,
    BoxFilter,
    Filter,
    GaussianFilter,
    MitchellFilter,
    TentFilter,
)

from penumbra_kernels.compile.tables import density_table

Array = NDArray[np.float64]
Profile = Callable[[Array], Array]

CELLS = 256
"""Of a curved filter: half an axis. In a cell it is a straight line, off by at most f'' / (8 CELLS^2)."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def _box(x: Array) -> Array:
    return np.ones_like(x)


def _tent(x: Array) -> Array:
    return 1.0 - x


def _gaussian(x: Array, sharpness: float) -> Array:
    """Less its own value at the radius, so that it ends at zero. sharpness: radius^2 / (2 stddev^2)."""
    return np.asarray(np.expm1(-sharpness * x * x) - np.expm1(-sharpness))


def _mitchell(x: Array, b: float, c: float) -> Array:
    """Mitchell and Netravali 1988, equation 8, stretched so that its support of 2 is the radius."""
    t = 2.0 * x
    inner = (12 - 9 * b - 6 * c) * t**3 + (-18 + 12 * b + 6 * c) * t**2 + (6 - 2 * b)
    outer = (-b - 6 * c) * t**3 + (6 * b + 30 * c) * t**2 + (-12 * b - 48 * c) * t + (8 * b + 24 * c)
    return np.where(t < 1.0, inner, outer) / 6.0


def _blackman_harris(x: Array) -> Array:
    """The minimum four-term window (Harris 1978, table I); it ends at 6e-5, not at zero."""
    a = np.pi * x
    return 0.35875 + 0.48829 * np.cos(a) + 0.14128 * np.cos(2 * a) + 0.01168 * np.cos(3 * a)


def profile_of(filter: Filter) -> Profile:  # noqa: A002 - the scene's own word
    """One axis of the filter by distance / radius in [0, 1]; separable, unnormalised, zero beyond 1."""
    if isinstance(filter, BoxFilter):
        return _box
    if isinstance(filter, TentFilter):
        return _tent
    if isinstance(filter, GaussianFilter):
        sharpness = 0.5 * min(filter.radius / filter.stddev, 1e100) ** 2
        return lambda x: _gaussian(x, sharpness)
    if isinstance(filter, MitchellFilter):
        b, c = filter.b, filter.c
        return lambda x: _mitchell(x, b, c)
    assert isinstance(filter, BlackmanHarrisFilter)
    return _blackman_harris


def _root(profile: Profile, low: float, high: float) -> float:
    """Where the profile changes its sign between two places, by halving."""
    rises = float(profile(np.array(low))) < 0.0
    while low < (middle := 0.5 * (low + high)) < high:
        below = (float(profile(np.array(middle))) < 0.0) == rises
        low, high = (middle, high) if below else (low, middle)
    return high


def _knots(profile: Profile, end: float) -> Array:
    """Even steps, the knot nearest to each zero crossing moved onto it, so that no cell has two signs."""
    knots = np.linspace(0.0, end, CELLS + 1)
    values = profile(knots)
    for i in np.flatnonzero(values[:-1] * values[1:] < 0.0):
        root = _root(profile, float(knots[i]), float(knots[i + 1]))
        nearest = i if root - knots[i] < knots[i + 1] - root else i + 1
        knots[nearest] = root
    return knots


def _end(filter: Filter) -> float:  # noqa: A002
    """Where the filter may be taken to end: beyond 9 deviations a Gaussian is less than 3e-18 of its peak."""
    return min(1.0, 9.0 * filter.stddev / filter.radius) if isinstance(filter, GaussianFilter) else 1.0


def _integrals(profile: Profile, knots: Array) -> Array:
    """Of |f| over each cell, by Gauss-Legendre quadrature."""
    half = 0.5 * np.diff(knots)
    middle = 0.5 * (knots[:-1] + knots[1:])
    values = profile(middle[:, None] + half[:, None] * _NODES[None, :])
    return np.asarray(np.abs(values @ _WEIGHTS) * half)


def compile_filter(filter: Filter) -> NDArray[np.float32]:  # noqa: A002
    """The filter's table (layout: `density_table`); its weight is that of both axes together."""
    profile = profile_of(filter)
    if isinstance(filter, (BoxFilter, TentFilter)):
        knots = np.array([0.0, 1.0])
        table = density_table(knots, profile(knots))
    else:
        knots = _knots(profile, _end(filter))
        values = profile(knots)
        values[np.abs(values) < 1e-14 * values[0]] = 0.0
        table = density_table(knots, values, _integrals(profile, knots))
    table[1] = table[1] * table[1]
    return table
