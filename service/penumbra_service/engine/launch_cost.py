"""What samples cost a device where leases are long, told from a pilot's short ones. Pure.

A pilot's nodes are blocks with few samples each, and launching one takes a time of its own: a half of the whole where
paths are short. A picture's nodes are tiles, of which it is nothing. Rounds with more samples a node tell the two apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

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
    rounds = rounds[1:] if len(rounds) > 1 else rounds
    last = rounds[-1]
    most = last.seconds / last.samples
    each = [work.samples / work.nodes for work in rounds]
    if max(each) < LEAST_GROWTH * min(each):
        return Cost(0.0, most)
    rows = np.array([(work.nodes / work.seconds, work.samples / work.seconds) for work in rounds])
    sample = float(np.clip(np.linalg.lstsq(rows, np.ones(len(rounds)))[0][1], LEAST_SHARE * most, most))
    return Cost((last.seconds - sample * last.samples) / last.nodes, sample)
