"""Discrete distributions for a device whose uniform numbers have 24 bits: CDFs and Walker's alias table.

Probabilities are rounded, in float64, to multiples of 2^-24 with at least one step for every weight above
zero. So what the device takes for a probability is exactly the share of the uniform numbers that lead there,
whatever the ratio of the largest weight to the smallest: no entry is chosen more or less often than it says.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import ALIAS

STEPS: Final = 1 << 24
"""Uniform numbers that a device can draw."""
MAX_ENTRIES: Final = STEPS // 2
"""Beyond it rounding could leave an entry without a step of its own."""

LIFTED: Final = 1.0 + 1e-6
"""Steps below which a weight counts as one step; above 1, so that the sums' own rounding leaves it one."""


def quantised_cdf(weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """(..., n + 1) cumulative steps, from 0 to STEPS, of weights (..., n) >= 0; all alike where all are zero.

    Raises ValueError for more than MAX_ENTRIES weights, or negative or non-finite ones.
    """
    w = np.asarray(weights, np.float64)
    count = w.shape[-1]
    if count > MAX_ENTRIES:
        raise ValueError(f"{count} entries to choose from, but at most {MAX_ENTRIES} are possible")
    if not np.all(np.isfinite(w)) or np.any(w < 0):
        raise ValueError("weights must be finite and not negative")
    largest = w.max(axis=-1, keepdims=True)
    w = np.where(largest > 0, w / np.where(largest > 0, largest, 1.0), 1.0)
    lifted = _lifted(w)
    free = STEPS - lifted.sum(axis=-1, keepdims=True)
    rest = np.where(lifted, 0.0, w)
    total = rest.sum(axis=-1, keepdims=True)
    running = np.cumsum(rest, axis=-1)
    running *= np.where(total > 0, 1.0, 0.0) * free / np.where(total > 0, running[..., -1:], 1.0)
    cdf = np.zeros((*w.shape[:-1], count + 1), np.int64)
    cdf[..., 1:] = np.rint(running).astype(np.int64) + np.cumsum(lifted, axis=-1)
    return cdf


def _lifted(w: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which weights above zero get exactly one step, so that the others share the rest by their size."""
    lifted = np.zeros(w.shape, bool)
    while True:
        free = STEPS - lifted.sum(axis=-1, keepdims=True)
        total = np.where(lifted, 0.0, w).sum(axis=-1, keepdims=True)
        more = (w > 0) & ~lifted & (w * free < LIFTED * total)
        if not more.any():
            return lifted
        lifted |= more


def quantised_pmf(weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) steps of each weight; they sum to STEPS. Raises as quantised_cdf."""
    return np.diff(quantised_cdf(weights))


def alias_table(weights: NDArray[np.float64]) -> NDArray[Any]:
    """(n,) of ALIAS for cl/lights/choice.cl: entry i's probability goes as weights[i] >= 0.

    Walker 1977, built as Vose 1991 does, but in integers: entry i of n owns the numbers k in [0, STEPS) with
    floor(k n / STEPS) = i, and keeps as many of them as fit. Raises as quantised_cdf.
    """
    count = len(weights)
    table = np.zeros(count, ALIAS)
    if count == 0:
        return table
    steps = quantised_pmf(np.asarray(weights, np.float64))
    starts = -(-np.arange(count + 1, dtype=np.int64) * STEPS // count)
    kept, other = _pair(steps.tolist(), np.diff(starts).tolist())
    first_lost = (starts[:-1] + kept) * count - np.arange(count, dtype=np.int64) * STEPS
    table["first"] = (starts[:-1] * count - np.arange(count, dtype=np.int64) * STEPS) / STEPS
    table["threshold"] = np.minimum(first_lost, STEPS) / STEPS
    table["other"] = other
    table["pmf"] = steps / STEPS
    return table


def _pair(wanted: list[int], room: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each entry: how many of its numbers it keeps, and who gets the others."""
    kept = np.zeros(len(wanted), np.int64)
    other = np.arange(len(wanted), dtype=np.int64)
    short = [i for i, (w, r) in enumerate(zip(wanted, room, strict=True)) if w < r]
    over = [i for i, (w, r) in enumerate(zip(wanted, room, strict=True)) if w >= r]
    while short:
        i = short.pop()
        donor = over[-1]
        kept[i] = wanted[i]
        other[i] = donor
        wanted[donor] -= room[i] - wanted[i]
        if wanted[donor] < room[donor]:
            short.append(over.pop())
    for i in over:
        kept[i] = room[i]
    return kept, other
