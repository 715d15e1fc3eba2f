"""The order of a job's batches: which end is being checked, which is planned ahead, and when to plan the
next.

A batch is all samples between two check points, of every tile. While batch k is being finished and checked,
the devices already work on batch k + 1, but never on k + 2: so none idles at a barrier, and at most one batch
is dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from penumbra_service.film.error import ImageError
from penumbra_service.film.predict import earliest
from penumbra_service.film.stop import Reason, StopRule, last_end_within

MIN_BATCH_SECONDS: Final = 0.5
"""Where check points are free, batches take at least this."""
LOOK_FACTOR: Final = 10.0
"""And so many times what looking at the last batch took."""

OVERTIME: Final = 0.05
"""A batch that is done within this share of the time asked for is waited for."""


@dataclass
class Batches:
    """Ends are samples a replicate. Pure bookkeeping, one writer."""

    rule: StopRule
    checked: int = 0
    """Samples below it are decided to count."""
    current: int | None = None
    """The end that is to be checked next."""
    ahead: int | None = None
    """The end of the batch that is worked on beyond it."""
    ends: list[int] = field(default_factory=list)
    """Every end that was checked."""
    errors: dict[int, float] = field(default_factory=dict)
    """relmse, as each of them showed it."""
    settled: int | None = None
    """Where the rule has ended the render."""

    def reopen(self, ends: tuple[int, ...]) -> None:
        """Take up the batches that an earlier run had begun."""
        self.current = ends[0] if ends else None
        self.ahead = ends[1] if len(ends) > 1 else None

    @property
    def open_ends(self) -> tuple[int, ...]:
        """Ends of the batches that are begun and not checked."""
        return tuple(end for end in (self.current, self.ahead) if end is not None)

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """(first, end) of all that is asked for: what counts already, and the batches that are begun."""
        bounds = (0, self.checked, *self.open_ends)
        return [(first, end) for first, end in pairwise(bounds) if end > first]

    @property
    def barriers(self) -> tuple[int, ...]:
        """Where the render may yet end: tiles must not merge across these."""
        return tuple(end for end in (self.checked, self.current) if end)

    def open_next(
        self, rate: float | None, seconds_left: float | None, look_seconds: float = 0.0
    ) -> tuple[int, int] | None:
        """Open one more batch if the rule allows it; its (first, end). `rate`: samples a replicate per second of the
        whole picture, None while unknown; `seconds_left` of the time rule once all open work is done, None without
        one; `look_seconds`: what it takes to look at a batch."""
        if self.ahead is not None:
            return None
        start = self.checked if self.current is None else self.current
        end = self._next_end(start, rate, seconds_left, look_seconds)
        if end is None or end <= start:
            return None
        if self.current is None:
            self.current = end
        else:
            self.ahead = end
        return start, end

    def more_follows(self, rate: float | None, seconds_left: float | None) -> bool:
        """Whether another batch is sure to come after those that are open. `rate` and `seconds_left` as in `open_next`,
        which has just opened one: the seconds are those before it."""
        first, end = (self.checked, *self.open_ends)[-2:]
        following = self.rule.next_end(end)
        if self.rule.relative_error is not None or self.rule.deciding or following is None:
            return False
        if seconds_left is None:
            return True
        return (
            rate is not None
            and last_end_within(rate, seconds_left - (end - first) / rate, end, following) > end
        )

    def _next_end(
        self, start: int, rate: float | None, seconds_left: float | None, look_seconds: float
    ) -> int | None:
        end = self.rule.next_end(start, self._earliest(start))
        if end is None:
            return None
        if self.rule.relative_error is None and not self.rule.deciding and rate is not None:
            # Without an error rule check points decide nothing, so that speed may choose them.
            least = max(MIN_BATCH_SECONDS, LOOK_FACTOR * look_seconds)
            while (end - start) / rate < least:
                following = self.rule.next_end(end)
                if following is None:
                    break
                end = following
        if seconds_left is not None and rate is not None and start > 0:
            end = last_end_within(rate, seconds_left, start, end)
        return end

    def _earliest(self, start: int) -> float:
        """Samples a pixel before which the error cannot be met, by the last look before `start`. That one is over whenever
        this is asked, so that the devices' speed has no part in which check points there are."""
        target, known = self.rule.relative_error, [end for end in self.errors if end < start]
        if target is None or not known:
            return 0.0
        last = max(known)
        return earliest(self.rule.samples_at(last), self.errors[last], target)

    def check(self, seconds: float, error: ImageError) -> Reason | None:
        """The current batch is complete in every tile: stop, and why, or go on to the batch ahead."""
        assert self.current is not None
        self.ends.append(self.current)
        if error is not None and error.known:
            self.errors[self.current] = error.relmse
        reason = self.rule.decide(self.current, seconds, error)
        if reason is not None:
            self.settled = self.current
        else:
            self.checked = self.current
            self.current, self.ahead = self.ahead, None
        return reason

    def look_again(self) -> None:
        """The samples of the last end that was checked were wrong: it is the current one again. What was begun
        beyond it is not waited for."""
        if not self.ends:
            return
        self.current, self.ahead, self.settled = self.ends.pop(), None, None
        self.checked = self.ends[-1] if self.ends else 0

    def settle(self) -> int:
        """The end of the picture: where the rule held, or the last batch that was checked when time ran
        out."""
        if self.settled is None:
            self.settled = self.checked
        return self.settled

    def seconds_left(self, seconds: float, open_samples: float, rate: float | None) -> float | None:
        """Of the time rule after all open work is done. open_samples: samples a replicate of the whole
        picture."""
        if self.rule.seconds is None:
            return None
        pending = open_samples / rate if rate else 0.0
        return self.rule.seconds - seconds - pending

    def overdue(self, seconds: float, remaining: Callable[[], float]) -> bool:
        """Whether the time is up and the current batch, which needs `remaining()` more seconds, is not worth
        waiting for. A first picture is always finished."""
        limit = self.rule.seconds
        if limit is None or seconds < limit or self.checked == 0:
            return False
        return seconds + remaining() > (1 + OVERTIME) * limit
