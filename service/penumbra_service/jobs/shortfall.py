"""Whether a job's caps will end it before its error target does, and by how much. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

from penumbra_scene.job import Shortfall

from penumbra_service.film.predict import FIT_FROM, Point, Prediction, fit_fall, predict


def shortfall(
    points: Sequence[Point],
    target: float | None,
    confidence: float,
    samples: float | None,
    seconds: float | None,
) -> Shortfall | None:
    """Of a target with caps on samples (a pixel) and seconds (of tracing), from the checks so far.

    None where the target may yet be met: where the lower end of the prediction's interval lies within the caps, or
    nothing can be told.
    """
    if target is None or (samples is None and seconds is None):
        return None
    told = predict(points, target, confidence)
    if (
        told is None
        or not math.isfinite(points[-1].relmse)
        or points[-1].samples < min(FIT_FROM, samples or FIT_FROM)
    ):
        return None
    needed = {"samples": (told.samples_low, samples), "seconds": (told.seconds_low, seconds)}
    missed = [
        (cap / least, cap, name) for name, (least, cap) in needed.items() if cap is not None and cap < least
    ]
    if not missed:
        return None
    _, cap, name = min(missed)
    error = _error_at(points, told, samples, seconds)
    limit = f"{cap:,.0f} samples" if name == "samples" else f"{cap:,g} seconds"
    return Shortfall(
        target=target,
        needed_samples=told.samples,
        needed_seconds=told.seconds,
        cap="samples" if name == "samples" else "seconds",
        expected_error=error,
        message=(
            f"a relative error of {_percent(target)} needs about {_about(told.samples)} samples a pixel"
            f" ({_about(told.samples_low)} to {_about(told.samples_high)}) and {_about(told.seconds)} s;"
            f" the cap is {limit}, where the error will be about {_percent(error)}"
        ),
    )


def _error_at(
    points: Sequence[Point], told: Prediction, samples: float | None, seconds: float | None
) -> float:
    """Where the first cap ends the render."""
    last = points[-1]
    rate = (told.samples - last.samples) / max(told.seconds - last.seconds, 1e-9)
    ends = [samples] if samples is not None else []
    if seconds is not None:
        ends.append(last.samples + max(seconds - last.seconds, 0.0) * rate)
    growth = max(min(ends) / last.samples, 1.0)
    return math.sqrt(last.relmse * fit_fall(points).at(growth))


def _percent(error: float) -> str:
    return f"{100 * error:.2g} %"


def _about(number: float) -> str:
    """Two digits: 2317 is '2,300'."""
    if number <= 0:
        return "0"
    step = 10.0 ** (math.floor(math.log10(number)) - 1)
    rounded = round(number / step) * step
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.1f}"
