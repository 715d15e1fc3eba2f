"""A job's progress on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING, Final

from penumbra_scene.job import JobState, ProgressEvent

if TYPE_CHECKING:  # only a terminal sees a bar
    from rich.progress import Progress

_LINE_STEP: Final = 0.25
"""Share of the work between two lines where there is no terminal."""
DAY: Final = 86400.0
"""Seconds."""
YEARS_FROM: Final = 1000
"""Days."""


def count(samples: float) -> str:
    """Samples a pixel. Pixels may differ in theirs, so that their mean is no whole number."""
    return f"{samples:.4g}" if samples < 10_000 else f"{samples:,.0f}"


def percent(error: float | None) -> str:
    """An error as people write it: three digits."""
    return "unknown" if error is None else f"{100 * error:.3g} %"


def duration(seconds: float | None) -> str:
    """Seconds as people write them: 12.3 s, 1:15 min, 2:03:00 h, 3 d 4 h, 27 years."""
    if seconds is None:
        return "?"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    if seconds >= YEARS_FROM * DAY:
        return _years(seconds / (365.25 * DAY))
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours < 24:
        return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"
    days, hours = divmod(round(seconds / 3600), 24)
    return f"{days} d" + (f" {hours} h" if hours else "")


def _years(number: float) -> str:
    """In three digits."""
    if number >= 1e6:
        return f"{number / 1e6:.3g} million years"
    return f"{float(f'{number:.3g}'):,g} years"


def _numbers(event: ProgressEvent) -> str:
    words = [f"{count(event.samples_done)} samples", f"error {percent(event.relative_error)}"]
    if event.frames is not None:
        words.insert(0, f"{event.frames.done} of {event.frames.total} frames")
    if event.predicted_seconds is not None and not event.state.ended:
        interval = event.predicted_seconds_interval
        least = "at least " if interval is not None and interval.high is None else ""
        words.append(f"{least}{duration(event.predicted_seconds)} to go")
    return ", ".join(words)


def _bar() -> Progress:
    """On standard error, with columns for state, share, time and numbers."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:10}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    return Progress(*columns, TextColumn("{task.fields[numbers]}"), console=Console(stderr=True))


class ProgressView:
    """Use it in a `with` statement and call it with every event."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bar: Progress | None = None
        self._next_line = 0.0
        self._state: JobState | None = None
        self._warned = False
        if not quiet and sys.stderr.isatty():
            self._bar = _bar()
            self._task = self._bar.add_task("queued", total=1.0, numbers="")

    def __enter__(self) -> ProgressView:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, event: ProgressEvent) -> None:
        """Show it."""
        self._warn(event)
        if self._bar is not None:
            done = 1.0 if event.state == JobState.DONE else event.progress
            self._bar.update(
                self._task, completed=done, description=event.state.value, numbers=_numbers(event)
            )
        elif not self._quiet:
            self._line(event)

    def _warn(self, event: ProgressEvent) -> None:
        """Once, as soon as it is known that the error target is out of reach."""
        if self._quiet or self._warned or event.shortfall is None:
            return
        self._warned = True
        text = f"warning: {event.shortfall.message}"
        if self._bar is not None:
            self._bar.console.print(text, highlight=False)
        else:
            print(text, file=sys.stderr, flush=True)

    def _line(self, event: ProgressEvent) -> None:
        if event.state == self._state and event.progress < self._next_line:
            return
        self._state = event.state
        self._next_line = event.progress + _LINE_STEP
        print(
            f"{event.state.value:10} {100 * event.progress:3.0f} %  {_numbers(event)}",
            file=sys.stderr,
            flush=True,
        )
