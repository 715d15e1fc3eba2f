"""When a render ends: samples, seconds, or relative error with confidence, whichever comes first.

Samples are counted in each replicate here; check points are the same fractions of powers of two as in samples
a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from penumbra_service.film.error import ImageError
from penumbra_service.film.levels import LevelMap

Reason = Literal["samples", "seconds", "relative_error"]

MIN_CHECK_SAMPLES: Final = 16
"""Samples a pixel before an error target may end a render: with fewer, features that are seen rarely are not
seen yet."""
STEPS_PER_OCTAVE: Final = 4
"""Check at (1, 1.25, 1.5, 1.75) * 2^k samples."""


@dataclass(frozen=True)
class StopRule:
    """All rules of a job; those that are None do not apply."""

    replicates: int
    samples: int | None = None
    """Per replicate."""
    seconds: float | None = None
    relative_error: float | None = None
    confidence: float = 0.95
    levels: LevelMap | None = None
    """Adaptive: how the picture's pixels share in the axis of samples; else each takes all. Ends are indices of that
    axis then, and `samples` is one of them."""
    deciding: bool = False
    """Of a pilot: what it decides depends on all of its check points, so that none may be left out."""

    def samples_at(self, end: int) -> float:
        """A pixel, over all replicates, on average over the picture."""
        return self.replicates * (end if self.levels is None else self.levels.mean(end))

    @property
    def planned(self) -> float | None:
        """Samples a pixel at which the samples rule ends the render, on average over the picture."""
        return None if self.samples is None else self.samples_at(self.samples)

    @property
    def first_end(self) -> int:
        """The first check point: a power of two, at which pixels have a sample a replicate on average."""
        end = 1
        while self.levels is not None and self.levels.density > 0 and self.levels.mean(end) < 1:
            end *= 2
        return end

    @property
    def fine(self) -> bool:
        """Whether the end is found by looking, so that check points must be close."""
        return self.seconds is not None or self.relative_error is not None

    def next_end(self, end: int, earliest: float = 0.0) -> int | None:
        """The check point after `end` samples a replicate (0 to start); None where `end` is the last. `earliest`: samples a
        pixel before which the error is not met; of the check points that lie before it, only the last is taken, and at
        least one in an octave."""
        if self.samples is not None and end >= self.samples:
            return None
        following = self._following(end)
        if self.fine and end > 0:
            while (after := self._following(following)) <= 2 * end and self.samples_at(after) <= earliest:
                following = after
        return following if self.samples is None else min(following, self.samples)

    def _following(self, end: int) -> int:
        if end == 0:
            return self.first_end
        if not self.fine:
            return 2 * end
        if self.relative_error is None or self.samples_at(end) >= MIN_CHECK_SAMPLES:
            return next_check(end)
        while self.samples_at(end) < MIN_CHECK_SAMPLES:  # nothing ends a render before
            end *= 2
        return end

    def decide(self, end: int, seconds: float, error: ImageError | None) -> Reason | None:
        """Whether a picture of `end` samples a replicate, after `seconds` of tracing, is the last; why."""
        if self.relative_error is not None and error is not None and error.known:
            enough = self.samples_at(end) >= MIN_CHECK_SAMPLES
            if enough and error.upper(self.confidence) <= self.relative_error**2:
                return "relative_error"
        if self.samples is not None and end >= self.samples:
            return "samples"
        if self.seconds is not None and seconds >= self.seconds:
            return "seconds"
        return None


def next_check(end: int) -> int:
    """The smallest of 1, 2, 3 and (4, 5, 6, 7) * 2^k above `end`."""
    if end < STEPS_PER_OCTAVE:
        return end + 1
    step = 1 << (end.bit_length() - STEPS_PER_OCTAVE.bit_length())
    return (end // step + 1) * step


def last_end_within(rate: float, seconds_left: float, end: int, following: int) -> int:
    """How far a batch from `end` to `following` gets in the seconds that are left, at `rate` samples a
    replicate per second: the largest multiple of a quarter of the batch, so that few and large nodes make it
    up; `end` for none."""
    if not math.isfinite(rate) or rate <= 0:
        return following
    step = max((following - end) // STEPS_PER_OCTAVE, 1)
    steps = int(max(seconds_left, 0.0) * rate / step)
    return min(end + steps * step, following)
