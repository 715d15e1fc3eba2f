"""What samples cost a device where leases are long, told from a pilot's short ones. Pure.

A pilot's nodes are blocks with few samples each, and launching one takes a time of its own: a half of the whole where
paths are short. A picture's nodes are tiles, of which it is nothing. Rounds with more samples a node tell the two apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

LEAST_SHARE: Final = 0.25
"""Of the newest round's seconds that samples take at least: what is said to be less was not measured."""
LEAST_GROWTH: Final = 1.2
"""Of samples a node between rounds; below, the two costs cannot be told apart."""


@dataclass(frozen=True)
class Work:
    """Of one device: what a round, or a lease, was made of."""

    nodes: int
    samples: int
    seconds: float


@dataclass(frozen=True)
class Cost:
    """seconds = node * nodes + sample * samples."""

    node: float
    sample: float

    def seconds_per_sample(self, work: Work) -> float:
        """Of a lease, without its launches; never below 0."""
        return max(work.seconds - self.node * work.nodes, 0.0) / work.samples


def joined(works: Sequence[Work]) -> Work:
    """As one."""
    return Work(
        sum(work.nodes for work in works),
        sum(work.samples for work in works),
        sum(work.seconds for work in works),
    )


def fit(rounds: Sequence[Work]) -> Cost:
    """Least squares of relative deviations over rounds, in their order; all of them have samples and took some time.

    The first of several is left out, since it finds caches cold.
    """
    rounds = _warm(rounds)
    last = rounds[-1]
    most = last.seconds / last.samples
    each = [work.samples / work.nodes for work in rounds]
    if max(each) < LEAST_GROWTH * min(each):
        return Cost(0.0, most)
    sample = float(np.clip(_least_squares(rounds)[1], LEAST_SHARE * most, most))
    return Cost((last.seconds - sample * last.samples) / last.nodes, sample)


def unsteadiness(rounds: Sequence[Work]) -> float:
    """What a round's seconds deviate by from those that nodes and samples should take, relative standard deviation: a
    machine that is about other things too. 0 where fewer than three rounds can tell."""
    rounds = _warm(rounds)
    if len(rounds) < 3:
        return 0.0
    rest = _rows(rounds) @ _least_squares(rounds) - 1
    return math.sqrt(float(rest @ rest) / (len(rounds) - 2))


def _warm(rounds: Sequence[Work]) -> Sequence[Work]:
    return rounds[1:] if len(rounds) > 1 else rounds


def _rows(rounds: Sequence[Work]) -> NDArray[np.float64]:
    return np.array([(work.nodes / work.seconds, work.samples / work.seconds) for work in rounds])


def _least_squares(rounds: Sequence[Work]) -> NDArray[np.float64]:
    """(node, sample)."""
    return np.asarray(np.linalg.lstsq(_rows(rounds), np.ones(len(rounds)))[0])


@dataclass
class Rounds:
    """Of one device: what it has measured in a pilot."""

    leases: list[Work] = field(default_factory=list)
    """Of the newest round, or of whole tiles."""
    rounds: list[Work] = field(default_factory=list)
    """The earlier ones that it had leases of."""

    @property
    def samples_per_second(self) -> float:
        """In the newest round, with all that short leases cost."""
        newest = joined(self.leases)
        return newest.samples / newest.seconds if self.leases else 0.0

    @property
    def cost(self) -> Cost:
        return fit(self._all)

    @property
    def unsteadiness(self) -> float:
        return unsteadiness(self._all)

    @property
    def _all(self) -> list[Work]:
        return [*self.rounds, joined(self.leases)] if self.leases else self.rounds

    def begin_round(self) -> None:
        """What was measured so far is of an earlier one."""
        if self.leases:
            self.rounds.append(joined(self.leases))
            self.leases = []
