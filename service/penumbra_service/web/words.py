"""Numbers and states in words, as the pages show them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Final

from penumbra_scene.job import JobState, StopReason

STATES: Final = tuple(JobState)
"""The pages call a state what the API and the command line call it."""

REASONS: Final = {
    StopReason.SAMPLES: "all its samples were taken",
    StopReason.SECONDS: "its time was up",
    StopReason.RELATIVE_ERROR: "its error was low enough",
    StopReason.CANCELLED: "it was cancelled",
    StopReason.FAILED: "it failed",
    StopReason.QUOTA: "its key has used up its device-seconds",
}

UNKNOWN: Final = "–"
YEARS_FROM: Final = 1000
"""Days from which years are told."""
MANY: Final = 1e12
"""From which a count is told in three digits and a power."""
_RAISED: Final = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def percent(share: float | None) -> str:
    """0.01234 -> '1.2 %'."""
    if share is None:
        return UNKNOWN
    if share == 0:
        return "0 %"
    value = 100 * share
    if value < 0.000995:
        return f"{value:.1e} %"
    digits = 0 if value >= 99.5 else 1 if value >= 0.995 else 2 if value >= 0.0995 else 3
    return f"{value:.{digits}f} %"


def duration(seconds: float | None) -> str:
    """75.3 -> '1 min 15 s', 1e9 -> '31.7 years'."""
    if seconds is None:
        return UNKNOWN
    if seconds < 0.0995:
        return f"{1000 * seconds:.0f} ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    if seconds >= YEARS_FROM * 86400:
        return years(seconds)
    whole = round(seconds)
    for size, unit, smaller, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= size:
            rest = whole % size // smaller
            return f"{whole // size} {unit}" + (f" {rest} {name}" if rest else "")
    return f"{whole} s"


def brief(seconds: float) -> str:
    """Seconds under an axis, in one unit: 200.0 -> '200 s', 20000.0 -> '333 min'."""
    if seconds < 1000:
        return duration(seconds) if seconds < 9.95 else f"{seconds:.0f} s"
    for size, unit in ((60, "min"), (3600, "h")):
        if seconds < 1000 * size:
            return f"{seconds / size:.3g} {unit}"
    return years(seconds) if seconds >= YEARS_FROM * 86400 else f"{seconds / 86400:.3g} d"


def years(seconds: float) -> str:
    """1e12 -> '31 700 years', 1e15 -> '31.7 million years'."""
    value = seconds / (365.25 * 86400)
    if value >= 1e6:
        return f"{value / 1e6:.3g} million years"
    return f"{float(f'{value:.3g}'):,g} years".replace(",", "\u202f")


def count(number: float | None) -> str:
    """1234567 -> '1 234 567', with narrow spaces that do not break; fractions of small numbers are kept."""
    if number is None:
        return UNKNOWN
    if number != int(number) and number < 100:
        return f"{number:.3g}"
    if number >= MANY:
        digits, _, power = f"{number:.2e}".partition("e")
        return f"{digits} \u00d7 10{str(int(power)).translate(_RAISED)}"
    return f"{number:,.0f}".replace(",", "\u202f")


def size(number: int) -> str:
    """Bytes: 3100000 -> '3.1 MB'."""
    value = float(number)
    for unit in ("B", "kB", "MB", "GB"):
        if value < 999.5:
            return f"{value:.3g} {unit}"
        value /= 1000
    return f"{value:.3g} TB"


def scientific(number: float | None) -> str:
    """0.000123 -> '1.23e-04'."""
    return UNKNOWN if number is None else f"{number:.2e}"


def moment(when: datetime | None) -> str:
    """In UTC, to the second."""
    return UNKNOWN if when is None else when.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def ago(when: datetime, now: datetime) -> str:
    """'12 s ago', 'just now'."""
    seconds = (now - when).total_seconds()
    return "just now" if seconds < 5 else f"{duration(seconds)} ago"
