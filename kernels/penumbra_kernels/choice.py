"""Which of a scene's two programs renders first, and whether the other is worth building. Pure.

A scene can be rendered by its own program, which has just its effects, or by the generic one, which has all; the bits are
the same. The one that is predicted to be ready first renders first. Where that is the generic one, the scene's own is built
beside it as soon as that is expected to save more than it costs, and takes over between two leases. Seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

Program = Literal["specialised", "generic"]

GAIN: Final = 1.1
"""Samples a second by a scene's own program over those by the generic one, where a device has not been measured: the median
of the examples on a CPU (docs/effects.md)."""
PRIOR: Final[dict[str, tuple[float, float]]] = {"cpu": (-2.75, 0.00082), "gpu": (-3.4, 0.00335)}
"""By kind of device: seconds of building a program of n lines are a + b n, until that device has built some. Lines through the
smallest and the largest program of the examples: 4,949 and 7,569 lines (with those of the lanes) took 1.28 and 3.42 s of a
Zen 5 core; 2,510 and 3,408 without lanes 5 and 8 s by an H200's driver (docs/gpus.md)."""
PLAIN_SHARE: Final = 0.6
"""Of the seconds of building a scene's own program: those of the same for one path at a time, on a CPU. .45 to .55 on a Zen 5
core, for three examples and the scene whose start bench/latency.py measures."""
PLAIN_RATE: Final = 500_000.0
"""Paths a second that such a program follows on a core, in most scenes more: .27 to 3.9 million on a Zen 5 core in ten examples
and the scene whose start is measured, 2.2 million in the median."""
LANES_GAIN: Final = 3.6
"""Paths a second in lanes over those one at a time: the median of the same scenes, 2.4 to 6.0."""
LEAST_BUILD: Final = 0.3
"""Seconds that any program takes."""


@dataclass(frozen=True)
class Choice:
    """What to do for a scene that a device begins with, or goes on with."""

    first: Program
    """Renders until the other one takes over, if it does."""
    build_own: bool
    """Have the scene's own program built beside the generic one that renders."""


def build_seconds(lines: int, kind: str, past: Sequence[tuple[int, float]]) -> float:
    """Predicted for a program of so many active lines: the prior line of the device's kind, scaled by what programs took
    there before. past: (lines, seconds)."""
    guess = _prior(lines, kind)
    expected = sum(_prior(size, kind) for size, _ in past)
    return guess * sum(seconds for _, seconds in past) / expected if expected > 0 else guess


def _prior(lines: int, kind: str) -> float:
    a, b = PRIOR.get(kind, PRIOR["cpu"])
    return max(a + b * lines, LEAST_BUILD)


def is_short(paths: float | None, plain: float, own: float, cores: int) -> bool:
    """Whether all of a job's paths are followed one at a time before the program that takes sixteen is there. paths: None where
    nobody knows how many; plain, own: seconds until either program is ready."""
    return paths is not None and plain + paths / (PLAIN_RATE * cores) < own


def seconds_to_come(planned: float | None, done: float, spent: float) -> float:
    """Of rendering by the generic program. planned: by the job's stop rule, None where that does not tell; done: of this job
    so far; spent: of all jobs so far that called for the same program of their own. What has been asked for so long is
    expected to be asked for as long again."""
    if planned is None:
        return float("inf")
    return max(planned - done, spent)


def choose(own: float, generic: float, to_come: float, gain: float, share: float) -> Choice:
    """own, generic: seconds until that program is ready, 0 where it is in the cache. to_come: seconds of rendering by the
    generic one that are still expected, possibly infinite. gain: samples a second, own over generic. share: of the device's
    speed that building takes away meanwhile."""
    if own <= generic:
        return Choice("specialised", build_own=False)
    # From when its own program is there, a second of the generic one's work takes 1 / gain.
    rest = max(to_come - max(own - generic, 0.0), 0.0)
    return Choice("generic", build_own=rest * (1.0 - 1.0 / gain) > own * share)
