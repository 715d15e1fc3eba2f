"""What each effect of a scene costs, in seconds and in noise."""

from __future__ import annotations

from penumbra_scene.base import Float, Integer, Measured, Model
from penumbra_scene.job import Count


class NoiseShare(Model):
    """What one group of random dimensions adds to the variance of a replicate's mean."""

    group: str
    """pixel, lens, time, lights, directions, or interactions: what several do together and none alone."""
    alone: Float
    """First-order sensitivity index; all rows add up to 1. An estimate: may come out a little below 0."""
    error: Float | None
    """Its standard error, from the spread over blocks. Null, unknown, where there is one block."""
    typical: Float = 0.0
    """The same share in a block, on average over blocks: what to go by where a few bright pixels carry the noise
    (`noise_peak`)."""
    typical_error: Float | None = None
    """Its standard error. Null, unknown, where no two blocks have noise."""
    together: Float | None = None
    """Total-effect index: the share that the group has a part in. Null for interactions."""


class EffectCost(Model):
    """Seconds of one camera path with an effect and without it, all else alike."""

    effect: str
    """`time` stands for all motion: the shutter is closed."""
    seconds: Measured
    seconds_without: Measured
    share: Float
    """Of the time: 1 - seconds_without / seconds. Below 0 where the plain thing in the effect's place costs more."""


class EffectsMeasured(Model):
    """Measured on a stratified choice of 8 x 8 blocks of the picture."""

    device: str
    blocks: Count
    samples: Integer
    """A pixel, all replicates together: shares of the noise hold at that number."""
    seconds: Measured
    """That measuring took, compiling included."""
    noise: tuple[NoiseShare, ...] = ()
    """Empty where the sampler is deterministic, or no block has any noise."""
    noise_peak: Float | None = None
    """The share of all noise that the noisiest hundredth of the blocks carries, one of them at least. Where it is large, shares
    of the whole are those of a few bright pixels. Null where `noise` is empty."""
    costs: tuple[EffectCost, ...] = ()
