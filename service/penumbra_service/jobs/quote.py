"""The quote, from what a pilot found. Pure."""

from __future__ import annotations

import math
from typing import Final

from penumbra_scene.check import picture_hash, scene_hash
from penumbra_scene.job import Interval, StopReason
from penumbra_scene.quote import QUOTED_ERRORS, Pilot, Quote, QuotedEnd, QuotedError
from penumbra_scene.receipt import ReceiptDevice, StageTime
from penumbra_scene.scene import Scene

from penumbra_service.film.allocation import Saving, pilot_samples
from penumbra_service.film.error import normal_quantile
from penumbra_service.film.predict import THETA_RANGE, error_at, fit_theta, predict, splitting_price
from penumbra_service.film.stop import MIN_CHECK_SAMPLES, next_check
from penumbra_service.jobs.pilot import PilotResult
from penumbra_service.jobs.receipt import error_point, too_dark

DEAREST_SPLIT: Final = 1.3
"""Times the samples of one sequence that eight replicates may cost to be advised; else four are."""
MOST_SAMPLES: Final = 1e15
"""Nobody waits for more."""
MUCH_FLAGGED: Final = 0.5
"""Share of flagged pixels from which a quote says that it may be far off."""


def build_quote(scene: Scene, time: float, found: PilotResult, warnings: tuple[str, ...] = ()) -> Quote:
    """A quote for a scene as it is to be rendered, `time` seconds into it."""
    confidence = scene.stop.confidence
    fit = fit_theta(found.points)
    half = normal_quantile(confidence) * fit.deviation
    known = bool(fit.points)
    return Quote(
        name=scene.name,
        scene_hash=scene_hash(scene),
        picture_hash=picture_hash(scene, time),
        stop=scene.stop,
        sampler=scene.sampler.type,
        replicates=found.layout.replicates,
        table=_table(scene, found),
        end=_end(scene, found),
        theta=fit.theta if known else None,
        theta_interval=(max(fit.theta - half, THETA_RANGE[0]), min(fit.theta + half, THETA_RANGE[1]))
        if known
        else None,
        seconds_per_sample=found.seconds_per_sample,
        compile=StageTime(seconds=found.compile_seconds, warm=found.compile_warm),
        build=StageTime(seconds=found.build_seconds, warm=found.build_warm),
        pilot=Pilot(
            pixels=found.pixels,
            blocks=found.blocks,
            blocks_in_picture=found.blocks_in_picture,
            samples=found.points[-1].samples,
            seconds=found.seconds,
            curve=tuple(error_point(point, confidence) for point in found.points),
        ),
        flagged_share=found.flagged_share,
        replicates_advised=_advised(found, fit.theta) if known else None,
        splitting_price=splitting_price(found.layout.replicates, fit.theta) if known else None,
        devices=tuple(
            ReceiptDevice(
                id=use.id,
                name=use.name,
                platform=use.platform,
                driver=use.driver,
                bit_class=use.bit_class,
                leases=use.leases,
                seconds=use.seconds,
            )
            for use in found.devices.values()
        ),
        warnings=(*_doubts(scene, found), *warnings),
    )


def _advised(found: PilotResult, theta: float) -> int:
    return 8 if splitting_price(8, theta) <= DEAREST_SPLIT else 4


def _table(scene: Scene, found: PilotResult) -> tuple[QuotedError, ...]:
    targets = set(QUOTED_ERRORS)
    if scene.stop.relative_error is not None:
        targets.add(scene.stop.relative_error)
    rows = (_quoted(scene, found, target) for target in sorted(targets, reverse=True))
    return tuple(row for row in rows if row is not None)


def _quoted(scene: Scene, found: PilotResult, target: float) -> QuotedError | None:
    confidence = scene.stop.confidence
    told = predict(found.points, target, confidence)
    if told is None:
        return None
    spread = _Spread(scene, found)
    even = [_whole(found, n) for n in (told.samples, told.samples_low, told.samples_high)]
    value, low, high = (max(spread.saving.samples * n, MIN_CHECK_SAMPLES) for n in even)
    samples = _Range(value, low, None if found.points[-1].of_few else high, confidence)
    seconds = samples.seconds(spread)
    return QuotedError(
        relative_error=target,
        samples=samples.value,
        samples_interval=samples.interval,
        seconds=seconds.value,
        seconds_interval=seconds.interval,
    )


class _Spread:
    """How the picture spreads its samples, and what that makes of an even one's samples and seconds."""

    def __init__(self, scene: Scene, found: PilotResult) -> None:
        self.saving = found.saving or Saving()
        self.rate = found.seconds_per_sample * self.saving.cost
        """Seconds of a sample a pixel, on average over the picture."""
        self.rate_deviation = found.rate_deviation
        self._even_rate = found.seconds_per_sample
        adaptive = scene.adaptive
        drops = adaptive is not None and adaptive.strategy == "error" and not adaptive.biased
        self._adaptive = adaptive if drops else None

    def pilot_seconds(self, samples: float) -> float:
        """Of the job's own pilot, which it drops before it takes so many samples a pixel."""
        if self._adaptive is None:
            return 0.0
        given = self._adaptive.pilot_samples
        even = samples / self.saving.samples
        return self._even_rate * (given or pilot_samples(even, self._adaptive.pilot))


class _Range:
    """A number with the ends of its interval; no upper one where it may be any number."""

    def __init__(self, value: float, low: float, high: float | None, confidence: float) -> None:
        self.value = value
        self.interval = Interval(low=low, high=high, confidence=confidence)
        self._ends = (low, high)
        self._confidence = confidence

    def ended_by(self, seconds: float, surely: bool) -> _Range:
        """Of seconds, where the clock ends them. surely: nothing else may."""
        low, high = self._ends
        low = seconds if surely else min(low, seconds)
        return _Range(min(self.value, seconds), low, min(high or seconds, seconds), self._confidence)

    def seconds(self, spread: _Spread) -> _Range:
        """The same in seconds of tracing, its ends wider by what the pilot's rate is uncertain."""
        wider = normal_quantile(self._confidence) * spread.rate_deviation
        pilot = spread.pilot_seconds(self.value)
        low, high = self._ends
        return _Range(
            self.value * spread.rate + pilot,
            (low * spread.rate + pilot) / (1 + wider),
            None if high is None else (high * spread.rate + pilot) * (1 + wider),
            self._confidence,
        )


def _whole(found: PilotResult, samples: float) -> float:
    """Samples at which a render can stop: its check points."""
    replicates = found.layout.replicates
    each = min(max(samples, MIN_CHECK_SAMPLES), MOST_SAMPLES) / replicates
    return float(replicates * next_check(max(math.ceil(each) - 1, 0)))


def _end(scene: Scene, found: PilotResult) -> QuotedEnd:
    """Which of the scene's rules holds first, as far as the pilot can tell."""
    stop, confidence, spread = scene.stop, scene.stop.confidence, _Spread(scene, found)
    ends: list[tuple[float, StopReason, _Range]] = []
    if stop.samples is not None:
        n = float(found.layout.samples or stop.samples)
        ends.append((n, StopReason.SAMPLES, _Range(n, n, n, confidence)))
    if stop.seconds is not None:
        wider = normal_quantile(confidence) * found.rate_deviation
        n = max(stop.seconds - spread.pilot_seconds(stop.seconds / spread.rate), 0.0) / spread.rate
        ends.append((n, StopReason.SECONDS, _Range(n, n / (1 + wider), n * (1 + wider), confidence)))
    if stop.relative_error is not None:
        row = _quoted(scene, found, stop.relative_error)
        if row is not None:
            n, i = row.samples, row.samples_interval
            ends.append((n, StopReason.RELATIVE_ERROR, _Range(n, i.low, i.high, confidence)))
    if not ends:  # an error alone is asked for, and no light was seen: nothing is known
        n = found.points[-1].samples
        ends.append((n, StopReason.RELATIVE_ERROR, _Range(n, n, n, confidence)))
    _, reason, samples = min(ends, key=lambda end: end[0])
    seconds = samples.seconds(spread)
    if stop.seconds is not None:
        seconds = seconds.ended_by(stop.seconds, surely=len(ends) == 1)
    error = error_at(found.points, samples.value / spread.saving.samples, confidence)
    return QuotedEnd(
        reason=reason,
        samples=samples.value,
        samples_interval=samples.interval,
        seconds=seconds.value,
        seconds_interval=seconds.interval,
        relative_error=None if error is None else error[0],
        relative_error_interval=None
        if error is None
        else Interval(
            low=error[1], high=None if found.points[-1].of_few else error[2], confidence=confidence
        ),
    )


def _doubts(scene: Scene, found: PilotResult) -> tuple[str, ...]:
    said = []
    if scene.adaptive is not None and found.saving is None:
        said.append(
            "the quote is for samples spread evenly; where they are refined by contrast it may be off either way"
        )
    last = found.points[-1]
    if found.layout.deterministic:
        said.append("the sampler is deterministic: samples and seconds can be quoted, errors cannot")
    elif found.layout.replicates < 2:
        said.append("one replicate has no spread: samples and seconds can be quoted, errors cannot")
    elif not last.relmse > 0:
        said.append("the pilot saw no noise at all: either there is none, or light that it never met")
    elif last.of_few:
        said.append(
            f"the pilot's error is that of some {max(last.carriers, 1):.0f} pixels: rare bright samples make it, and a longer "
            "render meets brighter ones. What an error takes is at least as much as quoted, and may be many times that"
        )
    elif found.flagged_share > MUCH_FLAGGED:
        share = f"{100 * found.flagged_share:.0f} %"
        said.append(
            f"{share} of the pilot's pixels are flagged: rare bright samples may make the real cost far higher"
        )
    said += too_dark(found.points)
    if found.rejected_share > 0:
        said.append(
            f"{100 * found.rejected_share:.2g} % of the pilot's samples were NaN, infinite or negative"
        )
    if len(found.points) < 3:
        said.append("the scene is too slow for a pilot of two seconds to tell how fast its error falls")
    return tuple(said)
