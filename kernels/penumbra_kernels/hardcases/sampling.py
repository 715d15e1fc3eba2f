"""Hard cases 40-44: uniform numbers, 64-bit keys, independence, and dimensions without end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.hardcases.benches.samplers import LENS, Draw, Sequences, bounce, eight_dimensions
from penumbra_kernels.hardcases.case import HardCase, Measure, Workbench, Z, at_least, at_most, hard_case

STOCHASTIC: Final = ("independent", "jittered", "sobol", "random", "stratified", "blue_noise")


def _samplers(bench: Workbench, *leave_out: str) -> Iterator[Draw]:
    """Three in the fast setting, all in the full one."""
    names = STOCHASTIC if bench.full else STOCHASTIC[:3]
    return (bench.get(Draw, name) for name in names if name not in leave_out)


@hard_case(
    40,
    "below-one",
    "Uniform numbers are never 1, for none of the 2^32 words that they are made of.",
    oracle="exhaustive: least 0, largest 1 - 2^-24 (fast setting: every 16th word, and each one's upper neighbour)",
    algorithm="(x >> 8) * 2^-24, exact in float32",
)
def below_one(bench: Workbench) -> Iterator[Measure]:
    sequences = bench.get(Sequences)
    out = np.empty((4096, 2), np.uint32)
    sequences("extremes", 4096, out, np.uint32(bench.count(16, 1)))
    lowest, highest = out[:, 0].min().view(np.float32), out[:, 1].max().view(np.float32)
    yield at_most("largest number", highest, 1 - 2.0**-24)
    yield at_most("least number", lowest, 0)
    yield at_least("least number", lowest, 0)


@hard_case(
    41,
    "wide-indices",
    "Sample indices around 2^32, of a 4K frame with 1024 samples, up to 2^62; pictures of 32768 x 32768 pixels.",
    oracle="all points distinct, in [0, 1)",
    algorithm="64-bit indices and keys; buffers a tile",
)
def wide_indices(bench: Workbench) -> Iterator[Measure]:
    index = np.array([0, 1, 2**32 - 1, 2**32, 2**32 + 1, 3840 * 2160 * 1024, 2**40, 2**62], np.uint64)
    x = np.array([0, 1, 32766, 32767, 0, 32767])
    y = np.array([0, 0, 0, 0, 32767, 32767])
    for draw in _samplers(bench, "random", "stratified"):
        points = draw(2, LENS, index, film=32768)
        far = draw(2, LENS, 0, x, y, film=32768, strata=16)
        alike = len(index) - len(np.unique(points, axis=0)) + len(x) - len(np.unique(far, axis=0))
        yield at_most(f"points that coincide, {draw.name}", alike, 0)
        yield at_most(f"largest coordinate, {draw.name}", max(points.max(), far.max()), 1 - 2.0**-24)


@hard_case(
    42,
    "neighbours",
    "Neighbouring pixels, replicates, seeds, dimensions and bounces are uncorrelated; no two pixels of a 4K frame share a key.",
    oracle="|r| < 4 / sqrt(n) would alarm once in 16,000: here 4.9 / sqrt(n); all keys distinct",
    algorithm="A counter hashed in 64 bits with full avalanche (SplitMix64's finaliser; Steele, Lea, Flood 2014)",
)
def neighbours(bench: Workbench) -> Iterator[Measure]:
    side = bench.count(128, 256)
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    for draw in _samplers(bench):
        worst = max(abs(r) for r in _correlations(draw, x, y))
        yield at_most(f"largest |r| sqrt(n), {draw.name}", worst * np.sqrt(x.size), Z)
    keys = np.empty(3840 * 2160, np.uint64)
    bench.get(Sequences)("keys", len(keys), keys, np.uint64(1), np.uint32(3840))
    keys.sort()
    yield at_most("keys that collide in a 4K frame", np.count_nonzero(np.diff(keys) == 0), 0)


def _correlations(draw: Draw, x: NDArray[Any], y: NDArray[Any]) -> Iterator[float]:
    keys: dict[str, Any] = {"strata": 16, "film": x.shape[0]}
    base = draw(2, bounce(0, 3), 5, x, y, 1, seed=7, **keys)
    others = [
        draw(2, bounce(0, 3), 5, x, y, 2, seed=7, **keys),
        draw(2, bounce(0, 3), 5, x, y, 1, seed=8, **keys),
        draw(2, bounce(0, 4), 5, x, y, 1, seed=7, **keys),
        draw(2, bounce(1, 3), 5, x, y, 1, seed=7, **keys),
        base[..., ::-1],
    ]
    if draw.name != "blue_noise":  # where neighbouring pixels are meant to be complementary
        others.append(draw(2, bounce(0, 3), 5, x + 1, y, 1, seed=7, **keys))
    for other in others:
        for axis in (0, 1):
            yield float(np.corrcoef(base[..., axis].reshape(-1), other[..., axis].reshape(-1))[0, 1])


@hard_case(
    43,
    "far-dimensions",
    "A product over dimensions up to bounce 65,535: none is the last, no two are the same.",
    oracle="its mean is 1 (a sequence that wraps to its third dimension gives 4/3)",
    algorithm="Padded pairs of Sobol dimensions, each Owen-scrambled by its own hash (Burley 2020)",
)
def far_dimensions(bench: Workbench) -> Iterator[Measure]:
    x, i = np.meshgrid(np.arange(4000), np.arange(16))
    for draw in _samplers(bench, "independent", "random", "stratified"):
        value = np.ones(x.shape)
        for k in (0, 1, 1000, 30000, 65535):
            value = value * 4 * np.prod(draw(2, bounce(k, 3), i, x, strata=16, film=4096), axis=-1)
        means = value.mean(axis=0)
        # Pixels of blue noise are not independent, but their means' sum varies less than if they were.
        z = abs(means.mean() - 1) / (means.std() / np.sqrt(means.size))
        yield at_most(f"|z| of the mean {means.mean():.3f}, {draw.name}", z, Z)


INTEGRANDS: Final[dict[str, tuple[Callable[[NDArray[np.float64]], NDArray[np.float64]], float]]] = {
    "1-D": (lambda u: np.asarray(np.exp(u[..., 0])), np.e - 1),
    "2-D edge": (lambda u: (u[..., 0] + 0.7 * u[..., 1] < 0.6).astype(np.float64), 0.6 * 0.6 / 1.4),
    "8-D smooth": (lambda u: np.asarray(np.prod(1 + 0.8 * (2 * u - 1), axis=-1)), 1.0),
    "8-D edge": (lambda u: (u.sum(axis=-1) < 4).astype(np.float64), 0.5),
}


@hard_case(
    44,
    "replicates-tell-the-truth",
    "The spread of replicates is the variance of their mean, in 1, 2 and 8 padded dimensions.",
    oracle="estimated over true variance, pooled over 6,000 pixels: 0.9 to 1.1; the mean unbiased",
    algorithm="Replicates scrambled independently; permutations whose pairs are uniform, so that padding does not correlate",
)
def replicates_tell_the_truth(bench: Workbench) -> Iterator[Measure]:
    pixels, replicates, count = 6000, 4, 8
    i, r, x = np.meshgrid(np.arange(count), np.arange(replicates), np.arange(pixels), indexing="ij")
    for draw in _samplers(bench):
        points = eight_dimensions(draw, i, x, r, strata=count, film=8192)
        for what, (function, truth) in INTEGRANDS.items():
            means = function(points).mean(axis=0)
            mean = means.mean(axis=0)
            true = ((mean - truth) ** 2).mean()
            # 6,000 pixels: both together vary by about sqrt(2 / 6000 + 2 / 18000) = 2.1 %, kurtosis adds little.
            ratio = means.var(axis=0, ddof=1).mean() / replicates / true
            yield at_most(
                f"deviation of estimated over true variance from 1, {draw.name}, {what}", abs(ratio - 1), 0.1
            )
            if draw.name != "blue_noise":
                z = abs((mean - truth).mean()) / np.sqrt(true / pixels)
                yield at_most(f"|z| of the mean, {draw.name}, {what}", z, Z)


CASES: Final[tuple[HardCase, ...]] = (
    below_one,
    wide_indices,
    neighbours,
    far_dimensions,
    replicates_tell_the_truth,
)
