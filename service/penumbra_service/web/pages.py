"""What the pages show of a job: read from the service, put into words, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from markupsafe import Markup
from penumbra_scene.job import ErrorPoint, FrameCounts, FrameStatus, JobState, JobStatus, Progress
from penumbra_scene.receipt import AdaptiveReport, Counts, Receipt
from pydantic import ValidationError

from penumbra_service.api.frames import frame_statuses
from penumbra_service.results import MOVIE, RECEIPT
from penumbra_service.service import RenderService
from penumbra_service.status import frame_numbers, job_status
from penumbra_service.store.artifacts import NoSuchArtifactError
from penumbra_service.store.jobs import JobRow
from penumbra_service.web import words
from penumbra_service.web.plot import Plot, error_plot

PAGE_LENGTH: Final = 24
FRAME_PAGE: Final = 96
"""Frames on one page of a job."""


@dataclass(frozen=True)
class JobView:
    """A job as the templates take it."""

    status: JobStatus
    state: str
    ended: bool
    percent: int
    facts: tuple[tuple[str, str], ...]
    """What stands beside the picture: name and value."""
    summary: str
    """One line for a card."""
    created: str
    can_cancel: bool
    can_pause: bool
    can_resume: bool


@dataclass(frozen=True)
class JobPageView:
    """All of a job's page."""

    job: JobView
    plots: tuple[Plot, ...]
    points: tuple[ErrorPoint, ...]
    receipt: Receipt | None
    receipt_rows: tuple[tuple[str, tuple[tuple[str, str], ...]], ...]
    """Headings, each with names and values."""
    frames: tuple[FrameStatus, ...] = ()
    """Of a job that has several: those of this page."""
    more_frames: int | None = None
    """The number after which the next page begins; None at the end."""
    first_frames: bool = True
    """Whether this is the page of the first ones."""
    movie: str | None = None
    """Its path, once there is one."""


def view_of(row: JobRow, *, curve: bool = False) -> JobView:
    """A job's view from its row in the ledger."""
    status = job_status(row, curve=curve)
    return JobView(
        status=status,
        state=status.state.value,
        ended=status.state.ended,
        percent=round(100 * status.progress),
        facts=_facts(status),
        summary=_summary(status),
        created=words.ago(status.created, datetime.now(UTC)),
        can_cancel=not status.state.ended,
        can_pause=status.state in (JobState.QUEUED, JobState.COMPILING, JobState.RENDERING),
        can_resume=status.state is JobState.PAUSED,
    )


def _summary(status: JobStatus) -> str:
    parts = []
    if status.frames is not None:
        parts.append(f"{status.frames.done} of {status.frames.total} frames")
    if status.relative_error is not None:
        parts.append(f"error {words.percent(status.relative_error)}")
    if status.samples_done:
        parts.append(f"{words.count(status.samples_done)} samples")
    if status.seconds:
        parts.append(words.duration(status.seconds))
    return " · ".join(parts)


def _facts(status: JobStatus) -> tuple[tuple[str, str], ...]:
    samples = words.count(status.samples_done)
    if status.samples_planned is not None:
        samples += f" of {words.count(status.samples_planned)}"
    facts = []
    if status.frames is not None:
        facts.append(("Frames", _frames(status.frames)))
    facts += [
        ("Samples a pixel", samples),
        ("Tracing", words.duration(status.seconds)),
        ("Relative error", error_in_words(status)),
    ]
    if not status.state.ended:
        facts.append(("Still to go", to_go(status)))
    if status.theta is not None:
        facts.append(("Variance falls as", _power(status.theta)))
    facts += [
        ("Picture", f"{status.width} × {status.height}"),
        ("Sampler", status.sampler),
        ("Stops at", _stop(status)),
    ]
    if status.shortfall is not None:
        facts.append(("Out of reach", status.shortfall.message))
    if status.stop_reason is not None and status.stop_reason in words.REASONS:
        what = "Ended because" if status.state.ended else "Paused because"
        facts.append((what, words.REASONS[status.stop_reason]))
    return tuple(facts)


def to_go(status: Progress) -> str:
    """'12 s (9–16 s)', or 'at least 12 s' where few pixels carry the error."""
    text, interval = words.duration(status.predicted_seconds), status.predicted_seconds_interval
    if status.predicted_seconds is None or interval is None or interval.low == interval.high:
        return text
    if interval.high is None:
        return f"at least {text}"
    return f"{text} ({words.duration(interval.low)}–{words.duration(interval.high)})"


def _frames(counts: FrameCounts) -> str:
    failed = f", {counts.failed} failed" if counts.failed else ""
    return f"{counts.done} of {counts.total}{failed}"


def _power(theta: float) -> Markup:
    """Samples to the power of -theta."""
    exponent = f"{-theta:.2f}".replace("-", "\u2212")
    return Markup("samples<sup>{}</sup>").format(exponent)


def error_in_words(status: JobStatus) -> str:
    """'2.1 % (1.9–2.4 %)'."""
    if status.relative_error is None:
        return words.UNKNOWN
    text = words.percent(status.relative_error)
    interval = status.relative_error_interval
    if interval is None:
        return text
    if interval.high is None:
        return f"{text} (at least {words.percent(interval.low)})"
    return f"{text} ({words.percent(interval.low).removesuffix(' %')}–{words.percent(interval.high)})"


def _stop(status: JobStatus) -> str:
    stop = status.stop
    rules = []
    if stop.relative_error is not None:
        rules.append(f"error {words.percent(stop.relative_error)}")
    if stop.seconds is not None:
        rules.append(words.duration(stop.seconds))
    if stop.samples is not None:
        rules.append(f"{words.count(stop.samples)} samples")
    return " or ".join(rules)


def page_of(service: RenderService, row: JobRow, after: int = -1) -> JobPageView:
    """A job's page, with its receipt if there is one; of several frames those above `after`."""
    job = view_of(row, curve=True)
    receipt = read_receipt(service, row.id)
    points: Sequence[ErrorPoint] = receipt.error.curve if receipt is not None else job.status.curve
    theta = None if job.ended else job.status.theta
    plots = (
        error_plot(points, over, target=job.status.stop.relative_error, theta=theta)
        for over in ("samples", "seconds")
    )
    numbers = [number for number in frame_numbers(row) if number > after]
    return JobPageView(
        frames=frame_statuses(service, row, numbers[:FRAME_PAGE]),
        more_frames=numbers[FRAME_PAGE - 1] if len(numbers) > FRAME_PAGE else None,
        first_frames=after < 0,
        movie=job.status.links.movie if job.ended and service.artifacts.exists(row.id, MOVIE) else None,
        job=job,
        plots=tuple(plot for plot in plots if plot is not None),
        points=tuple(points),
        receipt=receipt,
        receipt_rows=() if receipt is None else receipt_rows(receipt),
    )


def read_receipt(service: RenderService, job_id: str) -> Receipt | None:
    """The receipt; None if there is none (yet), or one of a version that this page does not know."""
    try:
        data = b"".join(service.artifacts.read(job_id, RECEIPT))
        return Receipt.model_validate_json(data)
    except (NoSuchArtifactError, ValidationError):
        return None


def receipt_rows(receipt: Receipt) -> tuple[tuple[str, tuple[tuple[str, str], ...]], ...]:
    """The receipt in words, by heading."""
    return (
        ("Error", _error_rows(receipt)),
        ("Predicted and real", _forecast_rows(receipt)),
        ("Samples and pixels", _count_rows(receipt)),
        *_adaptive_rows(receipt.adaptive),
        ("To make it again", _identity_rows(receipt)),
        (
            "Devices",
            tuple((d.name, f"{d.leases} leases, {words.duration(d.seconds)}") for d in receipt.devices),
        ),
        ("Versions", tuple(receipt.versions.items())),
    )


def _error_rows(receipt: Receipt) -> tuple[tuple[str, str], ...]:
    error = receipt.error
    theta = words.UNKNOWN if error.theta is None else f"{error.theta:.2f}"
    if error.theta is not None and error.theta_interval is not None:
        theta += f" ({error.theta_interval[0]:.2f} to {error.theta_interval[1]:.2f})"
    return (
        ("Relative error", words.percent(error.relative_error)),
        ("relMSE", words.scientific(error.relmse)),
        ("MSE", words.scientific(error.mse)),
        ("Exponent of the variance", theta),
        ("How variance was made", error.method),
    )


def _forecast_rows(receipt: Receipt) -> tuple[tuple[str, str], ...]:
    forecast = receipt.forecast
    samples = words.count(forecast.predicted_samples), words.count(forecast.real_samples)
    seconds = words.duration(forecast.predicted_seconds), words.duration(forecast.real_seconds)
    return (
        ("Predicted at", _of(forecast.at_samples, "samples")),
        ("Samples", "{} predicted, {} real".format(*samples)),
        ("Seconds", "{} predicted, {} real".format(*seconds)),
    )


def _of(number: float | None, what: str) -> str:
    return words.UNKNOWN if number is None else f"{words.count(number)} {what}"


def _count_rows(receipt: Receipt) -> tuple[tuple[str, str], ...]:
    counts = receipt.counts
    rejected = words.count(counts.rejected)
    if counts.rejected_in:
        rejected += ": " + ", ".join(f"{name} {words.count(n)}" for name, n in counts.rejected_in.items())
    return (
        ("Samples taken", words.count(counts.taken)),
        ("Samples that carried light", words.count(counts.lit)),
        ("Samples rejected", rejected),
        ("Rays per path", _rays_per_path(counts)),
        ("Pixels", words.count(counts.pixels)),
        (
            "Pixels with an uncertain error bar",
            f"{words.count(counts.flagged_pixels)} ({words.percent(counts.flagged_share)})",
        ),
        ("Pixels without a sample", words.count(counts.empty_pixels)),
    )


def _adaptive_rows(report: AdaptiveReport | None) -> tuple[tuple[str, tuple[tuple[str, str], ...]], ...]:
    if report is None:
        return ()
    pilot = f"{words.count(report.pilot_samples)} samples, {words.duration(report.pilot_seconds)}"
    levels = ", ".join(
        f"{words.count(level.samples)}: {words.percent(level.share)}" for level in report.levels
    )
    rows = (
        ("By", report.strategy if report.strategy == "contrast" else f"error, {report.mode}"),
        ("Pilot", f"{pilot}, {'kept' if report.biased else 'dropped'}"),
        ("Biased", "yes: the pilot is part of the picture" if report.biased else "no"),
        ("Samples a pixel, share of pixels", levels),
        *(() if report.shadow_rays is None else (("Shadow rays that pay", words.count(report.shadow_rays)),)),
    )
    return (("Adaptive sampling", rows),)


def _rays_per_path(counts: Counts) -> str:
    return words.UNKNOWN if counts.rays_per_path is None else f"{counts.rays_per_path:.2f}"


def _programs(receipt: Receipt) -> str:
    """The last program's hash, and what each rendered."""
    last = receipt.program_hash or words.UNKNOWN
    if not receipt.programs:
        return last
    parts = [f"{p.program} on {p.device}: {p.leases} leases" for p in receipt.programs]
    return f"{last} ({', '.join(parts)})"


def _identity_rows(receipt: Receipt) -> tuple[tuple[str, str], ...]:
    return (
        ("Scene", receipt.scene_hash),
        ("Program", _programs(receipt)),
        ("Bit class", receipt.bit_class),
        ("Sampler", f"{receipt.sampler}, {receipt.replicates} replicates"),
        ("Seed", receipt.seed),
        ("Work done again", f"{receipt.redone_leases} leases"),
    )
