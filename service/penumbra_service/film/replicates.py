"""How many replicates a job takes, and how its samples are laid out over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from penumbra_scene.settings import Sampler, Stop

DEFAULT_REPLICATES: Final = 4
"""Enough for a t-interval a pixel (3 degrees of freedom) at 1.0 to 1.3 times the samples of one replicate on the example
scenes (docs/accuracy.md)."""
DETERMINISTIC_SAMPLERS: Final = frozenset({"regular"})
"""Samplers whose replicates would all be alike: one is taken, and variance is not known."""


class UnknownErrorTargetError(ValueError):
    """A relative error is asked of a sampler whose error cannot be known."""


@dataclass(frozen=True)
class Layout:
    """Replicates and samples of a job; part of what determines its bits."""

    replicates: int
    samples: int | None
    """A pixel, over all replicates: the request rounded up to a multiple of `replicates`; None for no such
    rule."""
    strata: int
    """Samples a replicate where samples alone decide the end, else 0: strata then double as they fill."""
    deterministic: bool

    @property
    def samples_per_replicate(self) -> int | None:
        return None if self.samples is None else self.samples // self.replicates


def choose_layout(sampler: Sampler, stop: Stop) -> Layout:
    """DEFAULT_REPLICATES unless the sampler says otherwise, never more than samples. Raises
    UnknownErrorTargetError."""
    deterministic = sampler.type in DETERMINISTIC_SAMPLERS
    if stop.relative_error is not None:
        _demand_variance(sampler, stop, deterministic)
    replicates: int = 1 if deterministic else sampler.replicates or DEFAULT_REPLICATES
    samples = None
    if stop.samples is not None:
        replicates = min(replicates, 1 << (stop.samples.bit_length() - 1))
        samples = -(-stop.samples // replicates) * replicates
    alone = samples is not None and stop.seconds is None and stop.relative_error is None
    strata = samples // replicates if samples is not None and alone else 0
    return Layout(replicates, samples, strata, deterministic)


def pilot_samples(wanted: int) -> int:
    """Samples that each replicate of a pilot takes where so many are wanted: a power of two."""
    return 1 << max(wanted - 1, 0).bit_length()


def _demand_variance(sampler: Sampler, stop: Stop, deterministic: bool) -> None:
    if deterministic:
        raise UnknownErrorTargetError(
            f"stop.relative_error needs a random sampler; of {sampler.type!r} samples no error is known"
        )
    if sampler.replicates == 1 or stop.samples == 1:
        raise UnknownErrorTargetError("stop.relative_error needs at least 2 replicates and 2 samples")
