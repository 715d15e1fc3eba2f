"""What an error target will take: relmse falls as n^-theta, fitted by least squares of its logarithm against
log n.

theta is 1 for plain Monte Carlo, 1.44 on edges, more on smooth integrands; paths stay within [1, 1.5].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from penumbra_service.film.error import ImageError, normal_quantile

THETA_RANGE: Final = (1.0, 1.5)
FIT_FROM: Final = 16
"""Samples a pixel below which points are not fitted: relmse is then still mostly chance."""
FIT_SPAN: Final = 8
"""The fit looks at the last three octaves, n/8 to n: theta drifts as rare effects come to dominate."""
THETA_FLOOR: Final = 0.05
"""Least standard deviation given to theta: successive points share samples, so residuals understate it."""


@dataclass(frozen=True)
class Point:
    """One check of a running render."""

    samples: float
    """A pixel, on average over the picture."""
    seconds: float
    """Of tracing."""
    relmse: float
    upper: float
    """relmse with its allowance, which the stop rule compares."""
    deviation: float = 0.0
    mse: float = math.nan
    carriers: float = math.nan
    """Pixels that carry the error; NaN: not known."""
    of_few: bool = False
    """Whether these are so few that what a lower error will take has no upper bound."""
    floor: float = 0.0
    """The share of the error that the floor under dark blocks hides (error.ImageError)."""


def point_of(samples: float, seconds: float, error: ImageError, upper: float) -> Point:
    """A check whose allowance is `upper`."""
    found = (error.relmse, upper, error.deviation, error.mse, error.carriers, error.of_few, error.floor)
    return Point(samples, seconds, *found)


@dataclass(frozen=True)
class Fit:
    """theta and its standard deviation, both within what paths can do."""

    theta: float
    deviation: float
    points: int


@dataclass(frozen=True)
class Prediction:
    """Totals from the render's start, each with the ends of its interval."""

    samples: float
    samples_low: float
    samples_high: float
    seconds: float
    seconds_low: float
    seconds_high: float
    theta: float


def fit_theta(points: Sequence[Point]) -> Fit:
    """Least squares over the last octaves; the middle of the range where fewer than three points are
    there."""
    middle = sum(THETA_RANGE) / 2
    wide = Fit(middle, (THETA_RANGE[1] - THETA_RANGE[0]) / 4, 0)
    if not points:
        return wide
    from_samples = max(FIT_FROM, points[-1].samples / FIT_SPAN)
    used = [p for p in points if p.samples >= from_samples and p.relmse > 0 and math.isfinite(p.relmse)]
    if len(used) < 3:
        return wide
    x = [math.log(p.samples) for p in used]
    y = [math.log(p.relmse) for p in used]
    slope, deviation = _line(x, y)
    theta = min(max(-slope, THETA_RANGE[0]), THETA_RANGE[1])
    return Fit(theta, max(deviation, THETA_FLOOR), len(used))


def _line(x: list[float], y: list[float]) -> tuple[float, float]:
    n = len(x)
    mx, my = math.fsum(x) / n, math.fsum(y) / n
    sxx = math.fsum((a - mx) ** 2 for a in x)
    slope = math.fsum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / sxx
    rest = math.fsum((b - my - slope * (a - mx)) ** 2 for a, b in zip(x, y, strict=True))
    return slope, math.sqrt(rest / max(n - 2, 1) / sxx)


def predict(points: Sequence[Point], target: float, confidence: float = 0.95) -> Prediction | None:
    """Samples and seconds to a relative error of `target`; None where nothing is known yet.

    The interval takes in theta's deviation and that of the last relmse. Seconds go on at the rate of the last
    half.
    """
    known = [p for p in points if p.upper > 0 and math.isfinite(p.upper)]
    if not known:
        return None
    last = known[-1]
    fit = fit_theta(known)
    z = normal_quantile(confidence)
    ratio = last.upper / target**2
    high_theta = min(fit.theta + z * fit.deviation, THETA_RANGE[1])
    low_theta = max(fit.theta - z * fit.deviation, THETA_RANGE[0])
    spread = z * last.deviation
    n = last.samples * ratio ** (1 / fit.theta)
    shrunk, grown = ratio * max(1 - spread, 0.1), ratio * (1 + spread)
    ends = [last.samples * r ** (1 / t) for r in (shrunk, grown) for t in (low_theta, high_theta)]
    low, high = min(*ends, n), max(*ends, n)
    rate = _seconds_per_sample(known)
    seconds = [last.seconds + max(samples - last.samples, 0.0) * rate for samples in (n, low, high)]
    return Prediction(n, low, high, seconds[0], seconds[1], seconds[2], fit.theta)


def error_at(
    points: Sequence[Point], samples: float, confidence: float = 0.95
) -> tuple[float, float, float] | None:
    """The relative error after `samples` a pixel with the ends of its interval; None where nothing is known yet."""
    known = [p for p in points if p.relmse > 0 and math.isfinite(p.relmse)]
    if not known or samples <= 0:
        return None
    last, fit, z = known[-1], fit_theta(known), normal_quantile(confidence)
    grown = samples / last.samples
    thetas = [
        min(max(fit.theta + z * d, THETA_RANGE[0]), THETA_RANGE[1]) for d in (-fit.deviation, fit.deviation)
    ]
    ends = [
        last.relmse * max(1 + z * d, 0.1) * grown**-theta
        for d in (-last.deviation, last.deviation)
        for theta in thetas
    ]
    return math.sqrt(last.relmse * grown**-fit.theta), math.sqrt(min(ends)), math.sqrt(max(ends))


def earliest(samples: float, relmse: float, target: float) -> float:
    """Samples a pixel at which a relative error of `target` is met at the soonest, after `samples` that have shown `relmse`:
    by the steepest fall that paths have. What a stop rule compares has an allowance on top of relmse, which stands here for
    what a look errs by."""
    ratio = relmse / target**2
    return samples * ratio ** (1 / THETA_RANGE[1]) if ratio > 0 and math.isfinite(ratio) else 0.0


def upper_at(points: Sequence[Point], samples: float) -> float | None:
    """What a stop rule will compare after `samples` a pixel, if relmse and its allowance fall on as they did; None where
    nothing is known yet."""
    known = [p for p in points if p.upper > 0 and math.isfinite(p.upper)]
    if not known or samples <= 0:
        return None
    return float(known[-1].upper * (known[-1].samples / samples) ** fit_theta(known).theta)


def splitting_price(replicates: int, theta: float) -> float:
    """Samples to a given error in so many replicates over those of one sequence, R^((theta-1)/theta): a replicate
    has n/R samples, hence R^theta times the variance of n, of which the mean keeps 1/R."""
    return float(replicates ** ((theta - 1) / theta))


def _seconds_per_sample(points: Sequence[Point]) -> float:
    last = points[-1]
    earlier = [p for p in points if p.samples <= last.samples / 2 and p.seconds < last.seconds]
    if earlier:
        return (last.seconds - earlier[-1].seconds) / (last.samples - earlier[-1].samples)
    return last.seconds / last.samples
