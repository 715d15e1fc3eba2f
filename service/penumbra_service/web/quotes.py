"""What the submit page shows of a quote: its table and its plot, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass

from penumbra_scene.job import ErrorPoint, Interval
from penumbra_scene.quote import Quote, QuotedError

from penumbra_service.web import words
from penumbra_service.web.plot import Plot, error_plot


@dataclass(frozen=True)
class QuoteRow:
    """One error."""

    error: str
    samples: str
    seconds: str
    between: str
    asked: bool
    """Whether it is the scene's own target."""


@dataclass(frozen=True)
class QuoteView:
    """A quote as the template takes it."""

    name: str
    summary: str
    rows: tuple[QuoteRow, ...]
    plot: Plot | None
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]


def quote_view(quote: Quote) -> QuoteView:
    """In words."""
    return QuoteView(
        name=quote.name,
        summary=_summary(quote),
        rows=tuple(_row(row, quote.stop.relative_error) for row in quote.table),
        plot=_plot(quote),
        facts=_facts(quote),
        warnings=quote.warnings,
    )


def _summary(quote: Quote) -> str:
    end = quote.end
    seconds, samples = words.duration(end.seconds), words.count(end.samples)
    known = end.seconds_interval.high == end.seconds_interval.low
    between = "" if known else f" ({_between(end.seconds_interval)})"
    text = f"As it stands: {_least(end.seconds_interval)}{seconds} of tracing{between}"
    text += f", {_least(end.samples_interval)}{samples} samples a pixel"
    if end.relative_error is not None:
        text += f", a relative error of {words.percent(end.relative_error)}"
    return f"{text}. It would end because {words.REASONS[end.reason]}."


def _least(interval: Interval) -> str:
    """Before a number that has no upper bound."""
    return "at least " if interval.high is None else ""


def _between(interval: Interval) -> str:
    if interval.high is None:
        return f"{words.duration(interval.low)} or more"
    return f"{words.duration(interval.low)} to {words.duration(interval.high)}"


def _row(row: QuotedError, target: float | None) -> QuoteRow:
    return QuoteRow(
        error=words.percent(row.relative_error),
        samples=_least(row.samples_interval) + words.count(row.samples),
        seconds=_least(row.seconds_interval) + words.duration(row.seconds),
        between=_between(row.seconds_interval),
        asked=row.relative_error == target,
    )


def _facts(quote: Quote) -> tuple[tuple[str, str], ...]:
    pilot = quote.pilot
    facts = [
        ("Pilot", f"{pilot.blocks} of {pilot.blocks_in_picture} blocks in {words.duration(pilot.seconds)}"),
        ("Compiling, on top", _stage(quote.compile.seconds, quote.compile.warm)),
        ("Building, on top", _stage(quote.build.seconds, quote.build.warm)),
        ("Devices", ", ".join(device.name for device in quote.devices) or words.UNKNOWN),
    ]
    if quote.theta is not None:
        facts.append(("Variance falls as", f"samples to the power of \u2212{quote.theta:.2f}"))
    return tuple(facts)


def _stage(seconds: float, warm: bool | None) -> str:
    return "nothing: it is cached" if warm else words.duration(seconds)


def _plot(quote: Quote) -> Plot | None:
    """Errors against seconds, the intervals of the seconds turned into a band of errors along the same slope."""
    if quote.theta is None:
        return None
    points = [_point(row, quote.theta) for row in quote.table]
    return error_plot(points, "seconds", target=quote.stop.relative_error, theta=None)


def _point(row: QuotedError, theta: float) -> ErrorPoint:
    ends = row.seconds_interval

    def error_if_it_took(seconds: float) -> float:
        return float(row.relative_error * (max(seconds, 1e-9) / max(row.seconds, 1e-9)) ** (theta / 2))

    return ErrorPoint(
        samples=row.samples,
        seconds=row.seconds,
        relmse=row.relative_error**2,
        relative_error=row.relative_error,
        relative_error_interval=Interval(
            low=error_if_it_took(ends.low), high=error_if_it_took(ends.high or row.seconds)
        ),
    )
