"""How far a run is and when it will stop, in the contract's terms. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from penumbra_scene.job import Interval, Progress

from penumbra_service.film.predict import Point, fit_theta, predict
from penumbra_service.film.stop import StopRule
from penumbra_service.jobs.receipt import error_interval
from penumbra_service.jobs.record import RunRecord
from penumbra_service.jobs.shortfall import shortfall


@dataclass(frozen=True)
class Now:
    """Where a run stands."""

    samples: float
    """A pixel, on average over the picture."""
    seconds: float
    """Of tracing."""
    seconds_per_sample: float | None
    """A sample a pixel of the whole picture, at the devices' present rate."""


@dataclass(frozen=True)
class Forecast:
    """Where the nearest rule will stop the run: totals from its start."""

    samples: float
    """A pixel."""
    seconds: float
    seconds_low: float
    seconds_high: float | None
    """None: it has no upper end."""


def forecast(rule: StopRule, points: Sequence[Point], now: Now) -> Forecast | None:
    """The rule that is expected to hold first; None where nothing can be told."""
    if now.seconds_per_sample is None or now.seconds_per_sample <= 0:
        return None
    ends = []  # of samples, each with the ends of its interval
    if rule.samples is not None:
        ends.append((rule.samples_at(rule.samples),) * 3)
    if rule.seconds is not None:
        within = now.samples + max(rule.seconds - now.seconds, 0.0) / now.seconds_per_sample
        ends.append((within,) * 3)
    told = predict(points, rule.relative_error, rule.confidence) if rule.relative_error else None
    if told is not None:
        high = math.inf if points[-1].of_few else told.samples_high
        ends.append((told.samples, told.samples_low, high))
    if not ends:
        return None
    first = [min(numbers) for numbers in zip(*ends, strict=True)]
    seconds = [now.seconds + max(n - now.samples, 0.0) * now.seconds_per_sample for n in first]
    return Forecast(first[0], seconds[0], seconds[1], seconds[2] if math.isfinite(seconds[2]) else None)


def progress_of(
    rule: StopRule, record: RunRecord, told: Forecast | None, now: Now, at_least: float
) -> Progress:
    """A run's progress. at_least: the share that was reported before, which never falls."""
    last = record.points[-1] if record.points else None
    known = last is not None and math.isfinite(last.relmse)
    planned = rule.planned
    fit = fit_theta(record.points) if known else None
    return Progress(
        progress=max(at_least, _share(rule, told, now)),
        samples_done=min(now.samples, planned) if planned else now.samples,
        samples_planned=None if planned is None else round(planned),
        seconds=now.seconds,
        device_seconds=record.trace_seconds,
        relmse=last.relmse if known and last else None,
        relative_error=math.sqrt(last.relmse) if known and last else None,
        relative_error_interval=error_interval(last, rule.confidence) if known and last else None,
        theta=fit.theta if fit and fit.points else None,
        predicted_seconds=told.seconds - now.seconds if told else None,
        predicted_seconds_interval=_to_go(told, now, rule.confidence) if told else None,
        shortfall=shortfall(record.points, rule.relative_error, rule.confidence, rule.planned, rule.seconds),
    )


def _to_go(told: Forecast, now: Now, confidence: float) -> Interval | None:
    """None where a cap ends the run: it will at that number, and how its seconds will vary is not known."""
    if told.seconds_low == told.seconds_high:
        return None
    high = None if told.seconds_high is None else told.seconds_high - now.seconds
    return Interval(low=told.seconds_low - now.seconds, high=high, confidence=confidence)


def _share(rule: StopRule, told: Forecast | None, now: Now) -> float:
    shares = [0.0]
    if rule.planned is not None:
        shares.append(now.samples / rule.planned)
    if rule.seconds is not None:
        shares.append(now.seconds / rule.seconds)
    if told is not None and told.samples > 0:
        shares.append(now.samples / told.samples)
    # 1 is for a picture that is there.
    return min(max(shares), 0.999)
