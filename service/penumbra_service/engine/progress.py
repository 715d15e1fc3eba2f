"""How far a run is and when it will stop, in the contract's terms. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from penumbra_scene.job import Progress

from penumbra_service.film.predict import Point, fit_theta, predict
from penumbra_service.film.stop import StopRule
from penumbra_service.jobs.receipt import error_interval
from penumbra_service.jobs.record import RunRecord


@dataclass(frozen=True)
class Forecast:
    """Where the nearest rule will stop the run: totals from its start."""

    samples: float
    """A pixel."""
    seconds: float


def forecast(rule: StopRule, points: Sequence[Point], seconds_per_sample: float | None) -> Forecast | None:
    """The rule that is expected to hold first; None where nothing can be told. seconds_per_sample: at the
    devices' present rate, a sample a pixel of the whole picture."""
    if not points or seconds_per_sample is None or seconds_per_sample <= 0:
        return None
    last = points[-1]
    ends = []
    if rule.samples is not None:
        ends.append(float(rule.samples * rule.replicates))
    if rule.seconds is not None:
        ends.append(last.samples + max(rule.seconds - last.seconds, 0.0) / seconds_per_sample)
    if rule.relative_error is not None:
        told = predict(points, rule.relative_error, rule.confidence)
        if told is not None:
            ends.append(max(told.samples, float(last.samples)))
    if not ends:
        return None
    samples = min(ends)
    return Forecast(samples, last.seconds + max(samples - last.samples, 0.0) * seconds_per_sample)


def progress_of(
    rule: StopRule,
    record: RunRecord,
    told: Forecast | None,
    samples_done: float,
    seconds: float,
    at_least: float,
) -> Progress:
    """A run's progress. at_least: the share that was reported before, which never falls."""
    last = record.points[-1] if record.points else None
    known = last is not None and math.isfinite(last.relmse)
    planned = None if rule.samples is None else rule.samples * rule.replicates
    fit = fit_theta(record.points) if known else None
    return Progress(
        progress=max(at_least, _share(rule, told, samples_done, seconds)),
        samples_done=min(samples_done, planned) if planned else samples_done,
        samples_planned=planned,
        seconds=seconds,
        relmse=last.relmse if known and last else None,
        relative_error=math.sqrt(last.relmse) if known and last else None,
        relative_error_interval=error_interval(last, rule.confidence) if known and last else None,
        theta=fit.theta if fit and fit.points else None,
        predicted_seconds=max(told.seconds - seconds, 0.0) if told else None,
    )


def _share(rule: StopRule, told: Forecast | None, samples_done: float, seconds: float) -> float:
    shares = [0.0]
    if rule.samples is not None:
        shares.append(samples_done / (rule.samples * rule.replicates))
    if rule.seconds is not None:
        shares.append(seconds / rule.seconds)
    if told is not None and told.samples > 0:
        shares.append(samples_done / told.samples)
    # 1 is for a picture that is there.
    return min(max(shares), 0.999)
