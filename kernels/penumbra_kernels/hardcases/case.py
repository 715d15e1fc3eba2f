"""What a hard case is: a set-up that breaks naive code, an oracle, measured numbers and the bounds that they have to keep.

A case is a generator of `Measure`s: each is a number with a bound and needs no other. Cases run on one device, in a fast
setting (the whole catalogue within a minute or two) or a full one with more samples; the bounds are the same in both.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

if TYPE_CHECKING:
    from penumbra_kernels.device import Device

FALSE_ALARM: Final = 1e-6
"""Chance with which a statistical measure fails on right code; seeds are fixed, so that it does so always or never."""
Z: Final = 4.8916
"""Two-sided normal quantile of FALSE_ALARM."""

T = TypeVar("T")


@dataclass(frozen=True)
class Measure:
    """One measured number beside its bound."""

    what: str
    value: float
    bound: float
    at_least: bool = False
    """Whether the bound is a lower one."""
    coverage: bool = False
    """Whether this only shows that the case saw enough to judge by."""

    @property
    def passed(self) -> bool:
        """NaN never passes."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    @property
    def strain(self) -> float:
        """How near to its bound, 1 at it: what sorts a case's measures."""
        if not self.passed:
            return float("inf")
        a, b = (self.bound, self.value) if self.at_least else (self.value, self.bound)
        return a / b if b > 0 else 0.0


def at_least(what: str, value: Any, bound: float) -> Measure:
    """A measure with a lower bound."""
    return Measure(what, float(value), bound, at_least=True)


def enough(what: str, value: Any, bound: float) -> Measure:
    """A measure of how much was seen: the case's other numbers mean nothing below it."""
    return Measure(what, float(value), bound, at_least=True, coverage=True)


def at_most(what: str, value: Any, bound: float) -> Measure:
    """A measure with an upper bound; 0 where something must never happen."""
    return Measure(what, float(value), bound)


class Workbench:
    """What a case gets: the device, how much to do, and benches that cases share, each built once."""

    def __init__(self, device: Device, *, full: bool = False) -> None:
        self.device = device
        self.full = full
        self._made: dict[Hashable, Any] = {}

    def count(self, fast: int, full: int) -> int:
        """How many of something, by the setting."""
        return full if self.full else fast

    def get(self, make: Callable[..., T], *arguments: Hashable) -> T:
        """make(device, *arguments), built at the first call."""
        key = (make, *arguments)
        if key not in self._made:
            self._made[key] = make(self.device, *arguments)
        made: T = self._made[key]
        return made


Run = Callable[[Workbench], Iterator[Measure]]


@dataclass(frozen=True)
class HardCase:
    """One row of the catalogue."""

    number: int
    name: str
    """A few words with dashes, as `--case` takes it."""
    sentence: str
    oracle: str
    algorithm: str
    """What is done about it, and whose it is."""
    run: Run

    def __call__(self, bench: Workbench) -> Iterator[Measure]:
        return self.run(bench)


def hard_case(
    number: int, name: str, sentence: str, *, oracle: str, algorithm: str
) -> Callable[[Run], HardCase]:
    """Make the decorated generator a case."""
    return lambda run: HardCase(number, name, sentence, oracle, algorithm, run)


Status = Literal["passed", "failed", "crashed", "skipped"]


@dataclass(frozen=True)
class Outcome:
    """What came of one case on one device."""

    case: HardCase
    device: str
    status: Status
    measures: tuple[Measure, ...]
    seconds: float
    message: str = ""
    """Why it crashed or was skipped."""

    @property
    def worst(self) -> Measure | None:
        """The measure nearest to its bound, or beyond it."""
        judged = [m for m in self.measures if not (m.coverage and m.passed)]
        return max(judged, key=lambda m: m.strain, default=None)


class SkipCase(Exception):  # noqa: N818 - not an error
    """Raised by a case that cannot run here; its text says what is missing."""
