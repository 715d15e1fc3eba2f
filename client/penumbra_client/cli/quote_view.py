"""A quote on the terminal: a row for each error, its seconds as a range on one logarithmic axis."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Final

from penumbra_scene.job import Interval
from penumbra_scene.quote import Quote, QuotedEnd, QuotedError
from rich.console import Console
from rich.table import Table
from rich.text import Text

from penumbra_client.cli.progress import count, duration, percent

LEAST_CELLS: Final = 12
MOST_CELLS: Final = 48
"""Of the axis; a terminal too narrow for the least shows none."""
GAP: Final = 2
"""Columns between columns."""
HEAD: Final = ("error", "samples", "seconds", "from", "to")
MANY: Final = 1e9
"""Samples from which three digits tell enough."""
PAGE_WIDTH: Final = 100
"""Columns where there is no terminal."""
OPEN_ROOM: Final = 2.0
"""Times its seconds: what the axis has room for where they have no upper bound."""
_REASONS: Final = {"samples": "its samples", "seconds": "its time", "relative_error": "its error"}


def print_quote(quote: Quote, console: Console | None = None) -> None:
    """To standard output, with colours where that is a terminal."""
    if console is None:
        console = Console() if sys.stdout.isatty() else Console(width=PAGE_WIDTH)
    console.print(f"{quote.name}: {_end(quote.end)}", highlight=False, soft_wrap=True)
    console.print(_made(quote), style="dim", highlight=False, soft_wrap=True)
    if quote.table:
        rows = [_numbers(row) for row in quote.table]
        width = _width(rows)
        cells = min(console.width - width - GAP, MOST_CELLS)
        # No number is cut off: a terminal that is narrower still wraps.
        roomy = console if console.width >= width else Console(file=console.file, width=width)
        roomy.print(_table(quote, rows, cells))
    for warning in quote.warnings:
        console.print(f"warning: {warning}", highlight=False, soft_wrap=True)


def _end(end: QuotedEnd) -> str:
    error = ""
    if end.relative_error is not None:
        error = f", relative error {percent(end.relative_error)}{_percents(end.relative_error_interval)}"
    return (
        f"{_least(end.seconds_interval)}{duration(end.seconds)}{_durations(end.seconds_interval)} of tracing, "
        f"{_least(end.samples_interval)}{count(end.samples)} samples a pixel{error}; "
        f"{_REASONS.get(end.reason, str(end.reason))} will stop it"
    )


def _made(quote: Quote) -> str:
    pilot = quote.pilot
    parts = [
        f"pilot: {pilot.blocks} of {pilot.blocks_in_picture} blocks in {duration(pilot.seconds)}",
        f"compiling {_stage(quote.compile.seconds, quote.compile.warm)}",
        f"building {_stage(quote.build.seconds, quote.build.warm)}",
    ]
    if quote.theta is not None:
        parts.append(f"variance falls as samples^-{quote.theta:.2f}")
    return ", ".join(parts)


def _stage(seconds: float, warm: bool | None) -> str:
    return "none: it is cached" if warm else f"{duration(seconds)} on top"


def _least(interval: Interval, words: str = "at least ") -> str:
    """Before a number that has no upper bound."""
    return words if interval.high is None else ""


def _durations(interval: Interval) -> str:
    return (
        ""
        if interval.high in (None, interval.low)
        else _between(duration(interval.low), duration(interval.high))
    )


def _percents(interval: Interval | None) -> str:
    if interval is None:
        return ""
    if interval.high is None:
        return " or more"
    return _between(percent(interval.low), percent(interval.high))


def _between(low: str, high: str) -> str:
    return "" if low == high else f" ({low} to {high})"


def _numbers(row: QuotedError) -> tuple[str, ...]:
    """A cell under each word of HEAD."""
    ends = row.seconds_interval
    return (
        percent(row.relative_error),
        _least(row.samples_interval, "≥ ") + _samples(row.samples),
        _least(ends, "≥ ") + duration(row.seconds),
        duration(ends.low),
        duration(ends.high),
    )


def _samples(number: float) -> str:
    if number < MANY:
        return f"{number:,.0f}"
    digits, _, power = f"{number:.2e}".partition("e")
    return f"{digits}e{int(power)}"


def _width(rows: Sequence[Sequence[str]]) -> int:
    """Of all columns of numbers, with the gap after each."""
    return sum(max(map(len, column)) + GAP for column in zip(HEAD, *rows, strict=True))


def _table(quote: Quote, rows: Sequence[Sequence[str]], cells: int) -> Table:
    """Numbers, and an axis where it has room."""
    low, high = _span(quote.table)
    table = Table(box=None, header_style="bold", padding=(0, GAP, 0, 0))
    for name in HEAD:
        table.add_column(name, justify="right", no_wrap=True)
    drawn = cells >= LEAST_CELLS
    if drawn:
        table.add_column(_axis(low, high, cells), width=cells, no_wrap=True)
    for row, numbers in zip(quote.table, rows, strict=True):
        bar = [_bar(row, low, high, cells)] if drawn else []
        table.add_row(*numbers, *bar, style="bold" if row.relative_error == quote.stop.relative_error else "")
    return table


def _span(rows: Sequence[QuotedError]) -> tuple[float, float]:
    lows = [max(row.seconds_interval.low, 1e-3) for row in rows]
    highs = [max(row.seconds_interval.high or OPEN_ROOM * row.seconds, 1e-3) for row in rows]
    return min(lows), max(*highs, 1.01 * min(lows))


def _cell(seconds: float, low: float, high: float, cells: int) -> int:
    share = math.log(max(seconds, low) / low) / math.log(high / low)
    return min(round(share * (cells - 1)), cells - 1)


def _bar(row: QuotedError, low: float, high: float, cells: int) -> Text:
    """The interval as a line, the seconds as a dot on it."""
    first = _cell(row.seconds_interval.low, low, high, cells)
    ends = row.seconds_interval.high
    last = cells - 1 if ends is None else _cell(ends, low, high, cells)
    drawn = [" "] * cells
    drawn[first : last + 1] = "─" * (last + 1 - first)
    if ends is None:
        drawn[last] = "→"
    drawn[_cell(row.seconds, low, high, cells)] = "●"
    return Text("".join(drawn))


def _axis(low: float, high: float, cells: int) -> Text:
    """The ends of the axis, one where there is no room for two; logarithmic."""
    left, right = duration(low), duration(high)
    if len(left) + len(right) >= cells:
        return Text(left[:cells])
    return Text(left + " " * max(cells - len(left) - len(right), 1) + right)
