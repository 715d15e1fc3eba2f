"""What an error target will take: relmse falls as a / n + b / n^1.5, fitted by least squares over the last octaves.

Rough light transport falls as 1 / n, what samples stratify as n^-1.5 at best. The one is left when the other has gone, so that
the slope theta = -d log relmse / d log n of a picture, which lies within [1, 1.5], drifts to 1: a power law of the slope that a
pilot shows foretells too little for a long render.
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


@dataclass(frozen=True)
class Fall:
    """How relmse goes on: the share of it, at the last point, that falls as the steepest paths do; the rest falls as 1 / n."""

    share: float
    deviation: float
    """Standard, of the share."""

    def at(self, growth: float, share: float | None = None) -> float:
        """relmse after `growth` times the samples, over that of the last point."""
        s = self.share if share is None else share
        return float((1 - s) * growth ** -THETA_RANGE[0] + s * growth ** -THETA_RANGE[1])

    def growth_to(self, ratio: float, share: float | None = None) -> float:
        """Times the samples at which relmse is 1 / `ratio` of the last point's."""
        low, high = sorted(ratio ** (1 / theta) for theta in THETA_RANGE)  # of all that falls so, and so
        for _ in range(50):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.at(middle, share) * ratio > 1 else (low, middle)
        return float(high)

    def shares(self, z: float) -> tuple[float, float]:
        """The ends of the share's interval, z deviations wide to each side."""
        return max(self.share - z * self.deviation, 0.0), min(self.share + z * self.deviation, 1.0)


def fit_theta(points: Sequence[Point]) -> Fit:
    """The slope over the last octaves; the middle of the range where fewer than three points are there."""
    middle = sum(THETA_RANGE) / 2
    used = _fitted(points)
    if len(used) < 3:
        return Fit(middle, (THETA_RANGE[1] - THETA_RANGE[0]) / 4, 0)
    x = [math.log(p.samples) for p in used]
    y = [math.log(p.relmse) for p in used]
    _, slope, deviation = _line(x, y, [1.0] * len(used))
    theta = min(max(-slope, THETA_RANGE[0]), THETA_RANGE[1])
    return Fit(theta, max(deviation, THETA_FLOOR), len(used))


def fit_fall(points: Sequence[Point]) -> Fall:
    """With g a point's samples over the last one's, n relmse = c ((1 - s) + s g^-1/2) is a line in g^-1/2 - 1; points err by
    equal parts of themselves. Half and half where fewer than three points are there."""
    used = _fitted(points)
    floor = THETA_FLOOR / (THETA_RANGE[1] - THETA_RANGE[0])
    if len(used) < 3:
        return Fall(0.5, 0.25)
    last = used[-1]
    x = [math.sqrt(last.samples / p.samples) - 1 for p in used]
    y = [p.relmse * p.samples / (last.relmse * last.samples) for p in used]
    level, slope, deviation = _line(x, y, [v**-2 for v in y])
    if level <= 0:
        return Fall(1.0, max(deviation, floor))
    return Fall(min(max(slope / level, 0.0), 1.0), max(deviation / level, floor))


def _fitted(points: Sequence[Point]) -> list[Point]:
    """Those of the last octaves."""
    if not points:
        return []
    from_samples = max(FIT_FROM, points[-1].samples / FIT_SPAN)
    return [p for p in points if p.samples >= from_samples and p.relmse > 0 and math.isfinite(p.relmse)]


def _line(x: list[float], y: list[float], weights: list[float]) -> tuple[float, float, float]:
    """Weighted least squares: y at x = 0, the slope, and the slope's deviation."""
    total = math.fsum(weights)
    mx = math.fsum(w * a for w, a in zip(weights, x, strict=True)) / total
    my = math.fsum(w * b for w, b in zip(weights, y, strict=True)) / total
    sxx = math.fsum(w * (a - mx) ** 2 for w, a in zip(weights, x, strict=True))
    slope = math.fsum(w * (a - mx) * (b - my) for w, a, b in zip(weights, x, y, strict=True)) / sxx
    rest = math.fsum(w * (b - my - slope * (a - mx)) ** 2 for w, a, b in zip(weights, x, y, strict=True))
    return my - slope * mx, slope, math.sqrt(rest / max(len(x) - 2, 1) / sxx)


def predict(points: Sequence[Point], target: float, confidence: float = 0.95) -> Prediction | None:
    """Samples and seconds to a relative error of `target`; None where nothing is known yet.

    The interval takes in the deviations of the fall and of the last relmse. Seconds go on at the rate of the last
    half.
    """
    known = [p for p in points if p.upper > 0 and math.isfinite(p.upper)]
    if not known:
        return None
    last, fall, z = known[-1], fit_fall(known), normal_quantile(confidence)
    ratio = last.upper / target**2
    spread = z * last.deviation
    n = last.samples * fall.growth_to(ratio)
    shrunk, grown = ratio * max(1 - spread, 0.1), ratio * (1 + spread)
    ends = [last.samples * fall.growth_to(r, share) for r in (shrunk, grown) for share in fall.shares(z)]
    low, high = min(*ends, n), max(*ends, n)
    rate = _seconds_per_sample(known)
    seconds = [last.seconds + max(samples - last.samples, 0.0) * rate for samples in (n, low, high)]
    return Prediction(n, low, high, seconds[0], seconds[1], seconds[2])


def error_at(
    points: Sequence[Point], samples: float, confidence: float = 0.95
) -> tuple[float, float, float] | None:
    """The relative error after `samples` a pixel with the ends of its interval; None where nothing is known yet."""
    known = [p for p in points if p.relmse > 0 and math.isfinite(p.relmse)]
    if not known or samples <= 0:
        return None
    last, fall, z = known[-1], fit_fall(known), normal_quantile(confidence)
    grown = samples / last.samples
    ends = [
        last.relmse * max(1 + z * d, 0.1) * fall.at(grown, share)
        for d in (-last.deviation, last.deviation)
        for share in fall.shares(z)
    ]
    return math.sqrt(last.relmse * fall.at(grown)), math.sqrt(min(ends)), math.sqrt(max(ends))


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
    return known[-1].upper * fit_fall(known).at(samples / known[-1].samples)


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
