"""Hard cases 36, 37, 39, 46: what the film and its files make of samples that are rare, broken, or nearly alike.

Found by the entry point `penumbra.hardcases`; the tracer's own cases are in penumbra_kernels.hardcases.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.hardcases.case import (
    HardCase,
    Measure,
    SkipCase,
    Workbench,
    Z,
    at_least,
    at_most,
    enough,
    hard_case,
)
from penumbra_kernels.nodes import SumNode, Tile, merge
from penumbra_kernels.sums import Sums, no_sums
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

from penumbra_service.film import flags
from penumbra_service.film.develop import Developed
from penumbra_service.film.statistics import PixelStatistics, pixel_flags, pixel_statistics

REPLICATES: Final = 8


def _sums(values: NDArray[Any]) -> Sums:
    """Sums of gray samples (n, replicates, h, w), n a power of two, added as the tracer adds them."""
    leaves = []
    tile = Tile(0, 0, values.shape[3], values.shape[2])
    for i, sample in enumerate(values.astype(np.float32)):
        sums = no_sums(sample.shape)
        sums["rgba"] = sample[..., None]
        sums["taken"] = 1
        sums["lit"] = sample > 0
        leaves.append(SumNode(tile, i, 1, sums))
    while len(leaves) > 1:
        leaves = [merge(a, b) for a, b in zip(leaves[::2], leaves[1::2], strict=True)]
    return leaves[0].sums


def _statistics(sums: Sums) -> PixelStatistics:
    return pixel_statistics(Tile(0, 0, sums.shape[2], sums.shape[1]), sums)


@hard_case(
    36,
    "fireflies",
    "One sample in a thousand is worth 500: the mean stays right, and pixels with too few of them say so.",
    oracle="mean .5 over all pixels; no bright pixel passes for trustworthy",
    algorithm="Nothing is clamped, so that nothing is lost; Grubbs' test and a count of lit samples flag such pixels",
)
def fireflies(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(36)
    side = bench.count(64, 256)
    values = 500.0 * (rng.random((32, REPLICATES, side, side)) < 1e-3)
    pixels = _statistics(_sums(values))
    mean = pixels.mean[..., 0]
    error = np.sqrt(pixels.variance[..., 0].sum()) / mean.size
    yield at_most(f"|z| of the mean {mean.mean():.3f}", abs(mean.mean() - 0.5) / error, Z)
    yield at_most(
        "energy lost between samples and film",
        abs(mean.mean() * 32 * REPLICATES * mean.size / values.sum() - 1),
        1e-12,
    )
    trusted = (pixel_flags(pixels) & flags.UNTRUSTED) == 0
    yield at_most("bright pixels without a flag", np.count_nonzero(trusted & (mean > 0)), 0)
    yield enough("bright pixels", np.count_nonzero(mean > 0), 500)


def _half_broken() -> Any:
    """A floor lit by two point lights, one of them with a radiance of NaN (which no scene can say: it is put there)."""
    scene = {
        "version": 1,
        "camera": {
            "type": "orthographic",
            "height": 0.01,
            "transform": {"look_at": {"origin": [0, 2, 0], "target": [0, 0, 0], "up": [0, 0, 1]}},
        },
        "film": {"width": 8, "height": 8},
        "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
        "shapes": [{"type": "plane", "material": "gray"}],
        "lights": [{"type": "point", "position": [0, 3, 0], "intensity": 9 * np.pi} for _ in range(2)],
        "integrator": {"max_bounces": 0, "light_selection": "uniform"},
    }
    compiled = compile_scene(Scene.model_validate(scene), NoAssets())
    compiled.arrays["lights"]["radiance"][1] = np.nan
    return compiled


@hard_case(
    37,
    "nan-samples",
    "Samples that are NaN are counted and left out; the pixel's other samples are kept.",
    oracle="InvalidCount is their number, the effect is named, the mean is that of the others",
    algorithm="Each sample is looked at before it is added; counts and effects travel with the sums",
)
def nan_samples(bench: Workbench) -> Iterator[Measure]:
    samples = 64
    tracer = Tracer(bench.device, _half_broken(), SamplePlan(REPLICATES, samples), program="generic")
    sums = tracer.trace(Tile(0, 0, 8, 8), 0, samples).sums
    pixels = _statistics(sums)
    total = samples * REPLICATES
    yield at_most(
        "samples neither taken nor counted as rejected",
        np.abs(pixels.taken + pixels.rejected - np.uint64(total)).max(),
        0,
    )
    # Half of all choices fall on the broken light: binomial.
    z = abs(float(pixels.rejected.sum()) / (total * 64) - 0.5) * 2 * np.sqrt(total * 64)
    yield at_most("|z| of the share rejected", z, Z)
    # The good light is chosen half the time, and so counts twice.
    yield at_most("relative error of what the others say", np.abs(pixels.mean[..., :3] / 1.0 - 1).max(), 1e-4)
    bits = pixel_flags(pixels)
    named = (bits >> flags.EFFECT_SHIFT) & flags.EFFECTS["delta_light"]
    yield at_most("pixels that do not name the effect", np.count_nonzero(named == 0), 0)
    yield at_most("pixels without the flag", np.count_nonzero(bits & flags.REJECTED == 0), 0)


@hard_case(
    39,
    "small-noise-on-a-bright-wall",
    "A mean of 1000 with a deviation of .1: the variance is not lost in the square of the mean.",
    oracle="sigma^2 / n, to 1 % beyond the estimate's own noise",
    algorithm="Variance from the spread of replicate means about their mean, in float64: no sum of squares",
)
def small_noise_on_a_bright_wall(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(39)
    side, n = bench.count(64, 256), 64
    values = 1000 + 0.1 * rng.standard_normal((n, REPLICATES, side, side))
    variance = _statistics(_sums(values)).variance[..., 0]
    true = 0.1**2 / (n * REPLICATES)
    noise = Z * np.sqrt(2 / (REPLICATES - 1) / variance.size)
    ratio = variance.mean() / true
    yield at_most(
        f"|estimated over true variance - 1| beyond its noise ({ratio:.4f})",
        max(abs(ratio - 1) - noise, 0),
        0.01,
    )
    first = values[:, :, 0, 0].astype(np.float32).reshape(-1)
    naive = (
        np.float32((first**2).sum(dtype=np.float32) / first.size)
        - np.float32(first.mean(dtype=np.float32)) ** 2
    )
    yield at_least(
        "relative error of a float32 sum of squares, for comparison", abs(float(naive) / 0.01 - 1), 0.01
    )


@hard_case(
    46,
    "exr-range",
    "Radiance beyond half's 65504 and variances of 1e-38 come back from the EXR as they were; so do counts beyond 2^24.",
    oracle="equal bits after writing and reading; with `half` the largest half, never infinity",
    algorithm="FLOAT channels for picture and variance, UINT for counts, in one file of two parts",
)
def exr_range(bench: Workbench) -> Iterator[Measure]:
    try:
        from penumbra_service.images.exr import ExrLayout, write_exr
        from penumbra_service.images.exr_read import ExrReader
    except ImportError as error:
        raise SkipCase(f"{error.name} is not installed") from None
    values = np.array([[0.7, 65504, 65520, 1e5], [1e-38, 1e-30, 3.4e38, 1e-45]], np.float32)
    counts = np.array([[0, 1, 2**24, 2**24 + 1], [2**31, 2**32 - 1, 7, 0]], np.uint32)
    tile = Tile(0, 0, 4, 2)
    for half in (False, True):
        picture = Developed(tile, {"R": values, "Variance.R": values}, {"SampleCount": counts})
        layout = ExrLayout(tile, 4, 2, ("R", "Variance.R"), ("SampleCount",), half)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.exr"
            write_exr(path, layout, [picture])
            with ExrReader(path) as reader:
                (band,) = reader.bands()
        back = {**band.floats, **band.integers}
        lost = np.count_nonzero(back["Variance.R"] != values) + np.count_nonzero(
            back["SampleCount"] != counts
        )
        if half:
            yield at_most("largest value of a half picture", back["R"].max(), 65504)
        else:
            lost += np.count_nonzero(back["R"] != values)
        yield at_most(f"values changed, {'half' if half else 'float'}", lost, 0)


CASES: Final[tuple[HardCase, ...]] = (fireflies, nan_samples, small_noise_on_a_bright_wall, exr_range)
