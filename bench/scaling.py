"""How time grows with samples, triangles, lights and cores, and how long trees take.

    python bench/scaling.py [--largest 1000000]

Prints JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from typing import Any

import numpy as np
from clock import clock
from meshes import knot
from penumbra_kernels.accel.build import STATIC, Items
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.compile.bounds import padded
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.layout import PACKET8, TRIANGLE
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene
from scenes import SIZE, HeldMeshes, cornell, lights, mesh

REPLICATES = 8


def seconds_a_sample(data: dict[str, Any], held: HeldMeshes, samples: int = 16) -> float:
    """Seconds that one sample of every pixel takes; the best of three."""
    compiled = compile_scene(Scene.model_validate(data), held)
    count = max(samples // REPLICATES, 1)
    tracer = Tracer(Device(), compiled, SamplePlan(REPLICATES, count))
    tile = Tile(0, 0, SIZE, SIZE)
    tracer.trace(tile, 0, 1)
    taken = []
    for _ in range(3):
        started = clock()
        tracer.trace(tile, 0, count)
        taken.append(clock() - started)
    return min(taken) / (count * REPLICATES)


def over_samples() -> dict[str, float]:
    held = HeldMeshes()
    data = cornell(held)
    return {str(n): seconds_a_sample(data, held, n) for n in (8, 32, 128)}


def over_triangles(largest: int) -> dict[str, float]:
    result = {}
    for n in (n for n in (1_000, 10_000, 100_000, 1_000_000) if n <= largest):
        held = HeldMeshes()
        result[str(n)] = seconds_a_sample(mesh(held, n), held)
    return result


def over_lights() -> dict[str, float]:
    result = {}
    for n in (1, 10, 100, 1000):
        held = HeldMeshes()
        result[str(n)] = seconds_a_sample(lights(held, n), held)
    return result


def trees(largest: int) -> dict[str, Any]:
    """Seconds to build a tree, to find it on disk, and bytes a triangle on the device (tree, packets, records)."""
    result: dict[str, Any] = {}
    for n in (n for n in (1_000, 100_000, 1_000_000, 10_000_000) if n <= largest):
        positions, indices = knot(n)
        corners = positions[indices]
        count = len(indices)
        lo, hi = padded(corners.min(axis=1), corners.max(axis=1))
        del corners
        items = Items(lo, hi, np.full(count, STATIC, np.int32), np.arange(count, dtype=np.uint32))
        times = []
        for _ in range(2):  # the first builds and keeps, the second finds
            started = clock()
            tree = Trees(kept_bytes=0).tree(items, np.ones(1, np.int64))
            times.append(clock() - started)
        size = tree.nodes.nbytes + len(tree.packet_items) * PACKET8.itemsize
        size += count * TRIANGLE.itemsize + positions.nbytes
        result[str(n)] = {
            "build_seconds": round(times[0], 4),
            "found_seconds": round(times[1], 4),
            "bytes_a_triangle": round(size / count, 1),
        }
    return result


def rounded(value: Any) -> Any:
    """Three digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return float(f"{value:.3g}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--largest", type=int, default=1_000_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["PENUMBRA_CACHE"] = folder
        Trees().tree(_few(), np.ones(1, np.int64))  # numba compiles, or loads
        found = {
            "trees": trees(options.largest),
            "samples": over_samples(),
            "triangles": over_triangles(min(options.largest, 1_000_000)),
            "lights": over_lights(),
        }
    print(json.dumps(rounded(found)))


def _few() -> Items:
    lo = np.random.default_rng(1).random((5000, 3), np.float32)
    return Items(lo, lo + np.float32(0.01), np.full(5000, STATIC, np.int32), np.arange(5000, dtype=np.uint32))


if __name__ == "__main__":
    main()
