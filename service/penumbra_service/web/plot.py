"""The error as it fell, on two logarithmic axes: plain geometry, for a template to draw as SVG.

Coordinates are SVG user units: x to the right, y down, the whole WIDTH x HEIGHT.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from penumbra_scene.job import ErrorPoint

from penumbra_service.web.words import brief, count, percent

WIDTH: Final = 460
HEIGHT: Final = 260
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 14, 40
_FEWEST_POINTS: Final = 2
_STEPS: Final = ((1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0), (1.0, 2.0, 3.0, 5.0), (1.0, 2.0, 5.0), (1.0,))
"""Ticks within a decade, from the finest choice to the coarsest."""
_MOST_TICKS: Final = 6


@dataclass(frozen=True)
class Tick:
    """A place on an axis and its label."""

    at: float
    label: str


@dataclass(frozen=True)
class Plot:
    """What to draw."""

    title: str
    x_label: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    line: str
    """Points of the polyline."""
    dots: tuple[tuple[float, float], ...]
    band: str
    """Points of the confidence band's outline; '' without one."""
    target: float | None
    """y of the error that was asked for."""
    forecast: str
    """Points of the dashed line from the last point to the target; '' without one."""


@dataclass(frozen=True)
class _Axis:
    """A logarithmic axis: value -> user units."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return round(self.start + min(max(share, 0.0), 1.0) * (self.end - self.start), 2)


def error_plot(
    points: Sequence[ErrorPoint], over: str, *, target: float | None = None, theta: float | None = None
) -> Plot | None:
    """Relative error over `samples` or `seconds`; None while there are too few points to draw.

    `theta` is the exponent with which the variance falls: the error falls as samples^(-theta / 2), and so the
    forecast leads from the last point to the target.
    """
    known = [
        (_x(p, over), p.relative_error or 0.0, p) for p in points if _x(p, over) > 0 and p.relative_error
    ]
    if len(known) < _FEWEST_POINTS:
        return None
    end = _forecast_end(known[-1][0], known[-1][1], target, theta)
    xs = [x for x, _, _ in known] + ([end] if end is not None else [])
    ys = [y for _, y, _ in known] + ([target] if target is not None else [])
    ys += [bound for _, _, p in known for bound in _bounds(p)]
    x_axis = _axis(xs, LEFT, WIDTH - RIGHT)
    y_axis = _axis(ys, HEIGHT - BOTTOM, TOP)
    dots = tuple((x_axis(x), y_axis(y)) for x, y, _ in known)
    name = "samples a pixel" if over == "samples" else "seconds of tracing"
    return Plot(
        title=f"Relative error against {name}",
        x_label=name,
        x_ticks=_ticks(x_axis, count if over == "samples" else brief),
        y_ticks=_ticks(y_axis, percent),
        line=_joined(dots),
        dots=dots,
        band=_band(known, x_axis, y_axis),
        target=None if target is None else y_axis(target),
        forecast="" if end is None or target is None else _joined([dots[-1], (x_axis(end), y_axis(target))]),
    )


def _x(point: ErrorPoint, over: str) -> float:
    return point.samples if over == "samples" else point.seconds


def _bounds(point: ErrorPoint) -> list[float]:
    """The interval's bounds, as far as they are known and fit on a logarithmic axis beside the error."""
    interval, error = point.relative_error_interval, point.relative_error
    if interval is None or not error:
        return []
    low = max(interval.low, error / 10)
    high = min(interval.high, error * 10) if interval.high is not None else error * 10
    return [low, high]


def _forecast_end(x: float, error: float, target: float | None, theta: float | None) -> float | None:
    """Where the error, falling on as it fell, meets the target; seconds rise as samples do."""
    if target is None or theta is None or theta <= 0 or error <= target:
        return None
    return float(x * (error / target) ** (2.0 / theta))


def _axis(values: Sequence[float], start: float, end: float) -> _Axis:
    """From a little below the least value to a little above the greatest."""
    return _Axis(min(values) / 1.15, max(values) * 1.15, start, end)


def _ticks(axis: _Axis, name: Callable[[float], str]) -> tuple[Tick, ...]:
    first, last = math.floor(math.log10(axis.low)), math.ceil(math.log10(axis.high))
    for steps in _STEPS:
        values = [step * 10.0**power for power in range(first, last + 1) for step in steps]
        inside = [v for v in values if axis.low <= v <= axis.high]
        if len(inside) <= _MOST_TICKS:
            break
    inside = inside[:: -(-len(inside) // _MOST_TICKS)] if inside else [axis.low, axis.high]
    return tuple(Tick(axis(value), name(value)) for value in inside)


def _band(known: Sequence[tuple[float, float, ErrorPoint]], x_axis: _Axis, y_axis: _Axis) -> str:
    edges = [(x_axis(x), _bounds(p)) for x, _, p in known]
    there = [(x, bounds) for x, bounds in edges if bounds]
    if len(there) < _FEWEST_POINTS:
        return ""
    lower = [(x, y_axis(bounds[0])) for x, bounds in there]
    upper = [(x, y_axis(bounds[1])) for x, bounds in there]
    return _joined([*lower, *upper[::-1]])


def _joined(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{x:g},{y:g}" for x, y in points)
