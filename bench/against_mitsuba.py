"""One scene in Penumbra and in Mitsuba 3: a z-test on the pictures, and camera paths per second.

    python bench/against_mitsuba.py scene.json [--samples 256] [--runs 8] [--variant scalar_rgb] [--sampler independent]

Mitsuba renders `runs` seeds; their spread is its variance, Penumbra's is the one that it reports itself. Differences are
pooled over 8x8 blocks and channels before they are divided by their standard error: rms z is 1 where both agree.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

Array = NDArray[np.float64]
REPLICATES = 8


def penumbra(scene: Scene, samples: int) -> tuple[Array, Array, float]:
    """Mean, variance of the mean, seconds."""
    count = 1 << max(samples // REPLICATES - 1, 0).bit_length()
    tracer = Tracer(Device(), compile_scene(scene, NoAssets()), SamplePlan(REPLICATES, count))
    tile = Tile(0, 0, scene.film.width, scene.film.height)
    tracer.trace(tile, 0, 1)
    started = time.perf_counter()
    sums = tracer.trace(tile, 0, count).sums
    seconds = time.perf_counter() - started
    means = sums["rgba"][..., :3].astype(np.float64) / sums["taken"][..., None]
    mean = means.mean(axis=0)
    variance = ((means - mean) ** 2).sum(axis=0) / (REPLICATES * (REPLICATES - 1))
    return mean, variance, seconds * samples / (count * REPLICATES)


def mitsuba(scene: Scene, samples: int, runs: int, sampler: str) -> tuple[Array, Array, float]:
    """Mean over seeds, variance of that mean, seconds a run."""
    from mitsuba_scene import to_mitsuba

    loaded = mi.load_dict(to_mitsuba(scene, sampler))
    np.array(mi.render(loaded, spp=1, seed=999))
    started = time.perf_counter()
    pictures = np.stack([np.array(mi.render(loaded, spp=samples, seed=seed)) for seed in range(runs)]).astype(
        np.float64
    )
    seconds = (time.perf_counter() - started) / runs
    return pictures.mean(axis=0), pictures.var(axis=0, ddof=1) / runs, seconds


def blocks(image: Array, side: int = 8) -> Array:
    """Means over side x side blocks; what is left over at the right and bottom is dropped."""
    h, w = image.shape[0] // side * side, image.shape[1] // side * side
    return image[:h, :w].reshape(h // side, side, w // side, side, -1).mean(axis=(1, 3))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", type=Path)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--variant", default="scalar_rgb")
    parser.add_argument("--sampler", default="independent")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    scene = Scene.model_validate_json(options.scene.read_text())
    ours, our_variance, our_seconds = penumbra(scene, options.samples)
    theirs, their_variance, their_seconds = mitsuba(scene, options.samples, options.runs, options.sampler)
    variance = blocks(our_variance) / 64 + blocks(their_variance) / 64
    lit = variance > 0
    z = (blocks(ours) - blocks(theirs))[lit] / np.sqrt(variance[lit])
    pixels = scene.film.width * scene.film.height * options.samples / 1e6
    overall = (ours.mean() - theirs.mean()) / max(
        np.sqrt(our_variance.sum() + their_variance.sum()) / our_variance.size, 1e-12
    )
    print(
        json.dumps(
            {
                "rms_z": round(float(np.sqrt((z**2).mean())), 3),
                "max_z": round(float(np.abs(z).max()), 2),
                "z_of_image_mean": round(float(overall), 2),
                "means": [round(float(ours.mean()), 6), round(float(theirs.mean()), 6)],
                "paths_per_second_M": [round(pixels / our_seconds, 3), round(pixels / their_seconds, 3)],
                "variance_ratio_at_equal_samples": round(
                    float(our_variance.mean() / (their_variance.mean() * options.runs)), 3
                ),
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
