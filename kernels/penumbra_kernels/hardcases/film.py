"""Hard cases 38, 45, 47: long sums, tiles of any size, and one picture from two builds or devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene

from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device, devices
from penumbra_kernels.hardcases.benches.pictures import Picture, Renderer, busy
from penumbra_kernels.hardcases.case import HardCase, Measure, Workbench, at_most, enough, hard_case
from penumbra_kernels.nodes import FLOAT32_SAMPLES, SumNode, Tile, merge
from penumbra_kernels.sums import NAMES, no_sums
from penumbra_kernels.tracer import SamplePlan, Tracer

PIXEL: Final = Tile(0, 0, 1, 1)


def _doubled(node: SumNode, times: int) -> SumNode:
    """The node followed by copies of itself, up to 2^times as many samples."""
    for _ in range(times):
        following = SumNode(node.tile, node.sample_count, node.sample_count, node.sums, node.layers)
        node = merge(SumNode(node.tile, 0, node.sample_count, node.sums, node.layers), following)
    return node


@hard_case(
    38,
    "millions-of-samples",
    "A million samples and more in one pixel, of which the device sums 256 in float32; counters beyond 2^24.",
    oracle="the mean in float64, relative error 1e-6; the exact count of samples",
    algorithm="Pairwise float32 sums of 256 (error at most 8 * 2^-24: Higham 1993), float64 above; integer counters",
)
def millions_of_samples(bench: Workbench) -> Iterator[Measure]:
    radiance = 0.1
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "perspective"},
            "film": {"width": 1, "height": 1},
            "environment": {"type": "constant", "radiance": radiance},
        }
    )
    log2 = bench.count(20, 24)
    tracer = Tracer(bench.device, compile_scene(scene, NoAssets()), SamplePlan(1), program="generic")
    node = tracer.trace(PIXEL, 0, 1 << log2)
    exact = np.float64(np.float32(radiance))
    for count, summed in ((log2, node), (25, _doubled(node, 25 - log2))):
        mean = summed.sums["rgba"][0, 0, 0, 0] / (1 << count)
        yield at_most(f"relative error of the mean of 2^{count} samples", abs(mean / exact - 1), 1e-6)
        yield at_most(
            f"samples miscounted of 2^{count}", abs(int(summed.sums["taken"][0, 0, 0]) - (1 << count)), 0
        )
    values = np.random.default_rng(1).lognormal(0, 3, FLOAT32_SAMPLES * 64).astype(np.float32)
    leaves = []
    for i, value in enumerate(values):
        leaf = no_sums((1, 1, 1))
        leaf["rgba"], leaf["taken"] = value, 1
        leaves.append(SumNode(PIXEL, i, 1, leaf))
    while len(leaves) > 1:
        leaves = [merge(a, b) for a, b in zip(leaves[::2], leaves[1::2], strict=True)]
    total = leaves[0].sums["rgba"][0, 0, 0, 0]
    yield at_most(
        "relative error of a sum of uneven numbers", abs(total / values.sum(dtype=np.float64) - 1), 2.0**-21
    )


@hard_case(
    45,
    "tiles",
    "One picture in tiles of 1, 7, 64 pixels and of primes, in leases of any size: no seams, not a bit changes.",
    oracle="the picture in one piece, bit for bit",
    algorithm="Samples keyed by pixel, replicate and index; sums in one fixed binary tree",
)
def tiles(bench: Workbench) -> Iterator[Measure]:
    for sampler in ("sobol", "jittered") if bench.full else ("sobol",):
        compiled = compile_scene(busy(sampler), NoAssets())
        tracer = Tracer(bench.device, compiled, SamplePlan(2, 8), program="generic")
        whole = tracer.trace(Tile(0, 0, 24, 20), 0, 8).sums
        yield enough(f"samples with light, {sampler}", whole["lit"].sum(), 100)
        for side in (1, 7, 11, 64):
            changed = 0
            for y in range(0, 20, side):
                for x in range(0, 24, side):
                    tile = Tile(x, y, min(side, 24 - x), min(side, 20 - y))
                    left = (
                        merge(tracer.trace(tile, 0, 2), tracer.trace(tile, 2, 2))
                        if side > 1
                        else tracer.trace(tile, 0, 4)
                    )
                    part = merge(left, tracer.trace(tile, 4, 4)).sums
                    there = whole[:, y : y + tile.height, x : x + tile.width]
                    changed += sum(int((part[name] != there[name]).sum()) for name in NAMES)
        yield at_most(f"sums changed, tiles of {side}, {sampler}", changed, 0)


def pooled_z(a: Picture, b: Picture, block: int = 8) -> NDArray[np.float64]:
    """Differences of two pictures in standard errors of either, the variance pooled over blocks (a pixel's own may be 0)."""
    h, w = (n // block * block for n in a.mean.shape[:2])
    variance = 0.5 * (a.variance + b.variance)[:h, :w]
    pooled = variance.reshape(h // block, block, w // block, block, 3).mean(axis=(1, 3))
    error = np.sqrt(np.repeat(np.repeat(pooled, block, axis=0), block, axis=1))
    difference = (a.mean - b.mean)[:h, :w]
    return np.asarray(
        np.where(error > 0, difference / np.maximum(error, 1e-30), np.where(difference == 0, 0.0, np.inf))
    )


class PortableDevice(Device):
    """The device with programs that use no compiler builtins, as other compilers get them."""

    @property
    def flags(self) -> dict[str, int]:
        return {**super().flags, "PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0}


@hard_case(
    47,
    "two-builds",
    "The same seed on two devices, in the portable build and with the other kind of tree: pictures do not differ.",
    oracle="differences in standard errors pooled over 8 x 8 pixels: rms at most .1, mean at most .1",
    algorithm="The same keys draw the same samples everywhere; what rounding turns aside is far below the noise",
)
def two_builds(bench: Workbench) -> Iterator[Measure]:
    scene = busy("sobol", side=bench.count(48, 96))
    here = bench.get(Renderer)(scene, samples=64)
    own = bench.device.info.id
    others: list[tuple[str, Any]] = [("the portable build", PortableDevice(own))]
    tree = "compact" if bench.device.tree == "wide" else "wide"
    others.append((f"the {tree} tree", Device(own, tree)))
    others += [(info.id, Device(info.id)) for info in devices() if info.id != own]
    for name, device in others:
        z = pooled_z(here, Renderer(device)(scene, samples=64))
        yield at_most(f"rms z against {name}", np.sqrt(np.mean(z**2)), 0.1)
        yield at_most(f"|mean z| against {name}", abs(np.mean(z)), 0.1)


CASES: Final[tuple[HardCase, ...]] = (millions_of_samples, tiles, two_builds)
