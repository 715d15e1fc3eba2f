"""The receipt of a finished render, from the run's own record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from importlib import metadata
from typing import Final

from penumbra_kernels.allotment import own_samples
from penumbra_kernels.limits import not_covered
from penumbra_scene.check import check_scene, picture_hash, scene_hash
from penumbra_scene.job import ErrorPoint, Interval, StopReason
from penumbra_scene.measured import EffectsMeasured
from penumbra_scene.receipt import (
    AdaptiveReport,
    Counts,
    EffectReport,
    Forecast,
    LevelShare,
    PlanStep,
    Receipt,
    ReceiptDevice,
    ReceiptError,
    ReceiptFilm,
    ReceiptProgram,
    Stages,
    StageTime,
)
from penumbra_scene.scene import Scene

from penumbra_service.film.error import EPSILON, normal_quantile
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.predict import THETA_RANGE, Point, fit_theta
from penumbra_service.jobs.record import AdaptiveUse, RunRecord
from penumbra_service.jobs.sample_map import sample_map
from penumbra_service.jobs.shortfall import shortfall

DISTRIBUTIONS: Final = ("penumbra-render", "numpy", "pyopencl", "pocl-binary-distribution", "OpenImageIO")
"""Whose versions a receipt names."""


MOSTLY_FLOOR: Final = 0.5
"""Of ImageError.floor: relative to the picture's own brightness, its error is 1.4 times as large or more."""


@dataclass(frozen=True)
class ReceiptContext:
    """What the run itself does not know."""

    job: str
    name: str
    created: datetime
    started: datetime | None
    finished: datetime
    queue_seconds: float = 0.0
    write_seconds: float = 0.0
    time: float = 0.0
    """Seconds: when the scene was looked at."""
    frame: int | None = None
    """Its number, where the job has several."""
    effects_measured: EffectsMeasured | None = None
    warnings: tuple[str, ...] = field(default=())


def build_receipt(
    scene: Scene,
    record: RunRecord,
    reason: StopReason,
    context: ReceiptContext,
    levels: LevelMap | None = None,
) -> Receipt:
    """A receipt for a picture that ends at record.ends[-1] samples a replicate. `scene`: as rendered; `levels`: how its
    pixels shared in them, where it is adaptive."""
    counts = _counts(record)
    return Receipt(
        job=context.job,
        name=context.name,
        created=context.created,
        started=context.started,
        finished=context.finished,
        versions=versions(),
        scene_hash=scene_hash(scene),
        picture_hash=picture_hash(scene, context.time),
        program_hash=record.program_hash,
        kernel_hash=record.kernel_hash,
        time=context.time,
        frame=context.frame,
        film=ReceiptFilm(
            width=scene.film.width,
            height=scene.film.height,
            crop=scene.film.crop,
            filter=scene.film.filter,
            layers=scene.film.layers,
            half=scene.film.half,
        ),
        sampler=scene.sampler.type,
        seed=str(scene.sampler.seed),
        replicates=record.replicates,
        samples=counts.taken / counts.pixels if counts.pixels else 0.0,
        stop=scene.stop,
        stop_reason=reason,
        stages=_stages(record, context),
        error=_error(record, scene.stop.confidence),
        forecast=_forecast(record),
        counts=counts,
        adaptive=_adaptive(record, levels),
        effects_in=_effects(record, present=True),
        effects_out=_effects(record, present=False),
        effects_measured=context.effects_measured,
        not_covered=tuple(EffectReport(name=limit.name, reason=limit.reason) for limit in not_covered(scene)),
        devices=_devices(record),
        programs=_programs(record),
        bit_class=record.bit_class,
        plan=_plan(record),
        redone_leases=record.redone_leases,
        resumed=record.resumed,
        checked_leases=record.checked_leases,
        warnings=(
            *_of_scene(scene),
            *record.warnings,
            *context.warnings,
            *_black(counts),
            *_missed(scene, record, reason),
            *_of_few(record),
            *too_dark(record.points),
        ),
    )


def _of_scene(scene: Scene) -> Iterator[str]:
    """What is probably not meant, as validation tells it."""
    for found in check_scene(scene, allow_files=True):
        if found.warning:
            yield f"at {found.pointer or 'the top'}: {found.message}"


def _black(counts: Counts) -> tuple[str, ...]:
    """Where nothing was seen, which has no error either."""
    if counts.lit or not counts.taken:
        return ()
    return ("no sample met light: the picture is black, and an error of 0 says nothing",)


def _missed(scene: Scene, record: RunRecord, reason: StopReason) -> tuple[str, ...]:
    """What an error target that was not met would have taken."""
    stop = scene.stop
    if reason is StopReason.RELATIVE_ERROR or stop.relative_error is None or not record.points:
        return ()
    last = record.points[-1]
    caps: tuple[float | None, float | None] = (None, stop.seconds or record.seconds)
    if reason is StopReason.SAMPLES:
        caps = (stop.samples or last.samples, None)
    short = shortfall(record.points, stop.relative_error, stop.confidence, *caps)
    return () if short is None else (f"the error target was not met: {short.message}",)


def _of_few(record: RunRecord) -> tuple[str, ...]:
    """Where rare bright samples make the picture's error."""
    if not record.points or not record.points[-1].of_few:
        return ()
    pixels = max(record.points[-1].carriers, 1.0)
    return (
        f"some {pixels:.0f} pixels carry the picture's error: rare bright samples make it, so that it is little known, and a "
        "longer render may meet brighter ones",
    )


def too_dark(points: Sequence[Point]) -> tuple[str, ...]:
    """Where the floor that relmse gives dark blocks hides most of the newest error."""
    if not points or not points[-1].floor > MOSTLY_FLOOR:
        return ()
    floor = points[-1].floor
    times = 1 / math.sqrt(max(1 - floor, 1e-12))
    return (
        f"the picture is dark: the {EPSILON:g} added to squared radiance is {100 * floor:.0f} % of what its error is measured "
        f"against, so that an error target is met early; relative to its own brightness the error is {times:.2g} times as "
        "large or more. Brighter lights, or a smaller target, mend that",
    )


def _effects(record: RunRecord, *, present: bool) -> tuple[EffectReport, ...]:
    return tuple(
        EffectReport(name=e.name, reason=e.reason, pointer=e.pointer)
        for e in record.effects
        if e.present == present
    )


def versions() -> dict[str, str]:
    """Of this package and what it stands on, as installed."""
    found = {}
    for name in DISTRIBUTIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _counts(record: RunRecord) -> Counts:
    c = record.counts
    if c is None:
        return Counts(taken=0, lit=0, rejected=0, pixels=0)
    paths = c.taken + c.rejected
    return Counts(
        taken=c.taken,
        lit=c.lit,
        rejected=c.rejected,
        rays=c.rays,
        rays_per_path=c.rays / paths if paths else None,
        rejected_in={name: count for name, count in c.rejected_in.items() if count},
        pixels=c.pixels,
        flagged_pixels=c.flagged,
        flagged_share=c.flagged / c.pixels if c.pixels else 0.0,
        empty_pixels=c.flags.get("empty", 0),
    )


def _adaptive(record: RunRecord, levels: LevelMap | None) -> AdaptiveReport | None:
    use = record.adaptive
    if use is None:
        return None
    end, kept = record.ends[-1] if record.ends else 0, use.kept
    pixels = sum(use.levels.values())
    shares = [
        LevelShare(samples=record.replicates * own_samples(end, int(level), kept), share=count / pixels)
        for level, count in sorted(use.levels.items(), key=lambda entry: int(entry[0]))
    ]
    return AdaptiveReport(
        strategy=use.strategy,
        mode=use.mode,
        biased=kept > 0,
        pilot_samples=use.pilot_samples,
        pilot_seconds=use.pilot_seconds,
        theta=use.theta,
        shadow_rays=use.shadow_rays or None,
        levels=tuple(shares),
        map=sample_map(levels) if levels is not None else None,
    )


def adaptive_use(report: AdaptiveReport, levels: LevelMap) -> AdaptiveUse:
    """Back from a receipt, for a picture that is rendered again without the pilot."""
    return AdaptiveUse(
        report.strategy,
        report.mode,
        levels.kept,
        report.pilot_samples,
        0.0,
        report.theta,
        {str(level): count for level, count in levels.histogram.items()},
        levels.shadow_rays,
    )


def _stages(record: RunRecord, context: ReceiptContext) -> Stages:
    return Stages(
        queue=StageTime(seconds=context.queue_seconds),
        compile=StageTime(seconds=record.compile_seconds, warm=record.compile_warm),
        build=StageTime(seconds=record.build_seconds, warm=record.build_warm),
        trace=StageTime(seconds=record.trace_seconds),
        write=StageTime(seconds=context.write_seconds),
        wall_seconds=max((context.finished - context.created).total_seconds(), 0.0),
    )


def error_interval(point: Point, confidence: float) -> Interval | None:
    """The relative error's interval at one check; None where no error is known."""
    if not math.isfinite(point.relmse):
        return None
    spread = normal_quantile(confidence) * point.deviation
    return Interval(
        low=math.sqrt(point.relmse * max(1 - spread, 0.0)),
        high=math.sqrt(point.relmse * (1 + spread)),
        confidence=confidence,
    )


def error_point(point: Point, confidence: float) -> ErrorPoint:
    """A check as the contract writes it."""
    known = math.isfinite(point.relmse)
    return ErrorPoint(
        samples=point.samples,
        seconds=point.seconds,
        relmse=point.relmse if known else None,
        relative_error=math.sqrt(point.relmse) if known else None,
        relative_error_interval=error_interval(point, confidence),
    )


def _error(record: RunRecord, confidence: float) -> ReceiptError:
    last = record.points[-1] if record.points else None
    if last is None or not math.isfinite(last.relmse):
        return ReceiptError(method=method(record))
    fit = fit_theta(record.points)
    half = normal_quantile(confidence) * fit.deviation
    return ReceiptError(
        relmse=last.relmse,
        relative_error=math.sqrt(last.relmse),
        relative_error_interval=error_interval(last, confidence),
        mse=last.mse,
        theta=fit.theta if fit.points else None,
        theta_interval=(max(fit.theta - half, THETA_RANGE[0]), min(fit.theta + half, THETA_RANGE[1]))
        if fit.points
        else None,
        method=method(record),
        curve=tuple(error_point(p, confidence) for p in record.points),
    )


def method(record: RunRecord) -> str:
    """How variance was made, in words: also an attribute of the EXR."""
    if record.deterministic:
        return "none: the sampler is deterministic, variance is NaN"
    if record.replicates < 2:
        return "none: one replicate, variance is NaN"
    return (
        f"variance of the mean over {record.replicates} independent replicates, sum (m_r - m)^2 / (R (R - 1))"
    )


def _forecast(record: RunRecord) -> Forecast:
    real = record.points[-1].samples if record.points else 0
    told = record.foretold
    if told is None:
        return Forecast(real_samples=real, real_seconds=record.seconds)
    return Forecast(
        at_samples=told.at_samples,
        predicted_samples=told.samples,
        predicted_seconds=told.seconds,
        real_samples=real,
        real_seconds=record.seconds,
    )


def _devices(record: RunRecord) -> tuple[ReceiptDevice, ...]:
    return tuple(
        ReceiptDevice(
            id=use.id,
            name=use.name,
            platform=use.platform,
            driver=use.driver,
            bit_class=use.bit_class,
            leases=use.leases,
            seconds=use.seconds,
            failures=use.failures,
            blocked=use.blocked,
        )
        for use in record.devices.values()
    )


def _programs(record: RunRecord) -> tuple[ReceiptProgram, ...]:
    return tuple(ReceiptProgram.model_validate(asdict(use)) for use in record.programs if use.leases)


def _plan(record: RunRecord) -> tuple[PlanStep, ...]:
    steps = zip([0, *record.ends], record.ends, strict=False)
    return tuple(
        PlanStep(first_sample=first, sample_count=end - first) for first, end in steps if end > first
    )
