"""Every OpenCL device against every tree layout: camera paths per second, and what the driver says of the program.

    python bench/devices.py [--device pocl:0] [--trees wide compact] [--samples 64] [--json out.json]

Scenes are examples that name no files, and `mesh-N`: a bumpy sphere of about N triangles over a floor, made here. Paths a
second are the best of three renders of 8 replicates, after one that is thrown away; both layouts give the same bits, which
is checked.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import Image, MeshData, NoAssets
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_kernels.device import Device, devices
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
REPLICATES = 8
RUNS = 3
SCENES = ("cornell", "depth_of_field", "glossy", "many_lights", "mesh-100k", "mesh-1000k")
ANY_ASSET = "sha256:" + "0" * 64


class OneMesh:
    """Assets with a single mesh under any name."""

    def __init__(self, mesh: MeshData) -> None:
        self._mesh = mesh

    def image(self, ref: AssetRef) -> Image:
        return NoAssets().image(ref)

    def mesh(self, ref: AssetRef) -> MeshData:
        return self._mesh


def bumpy_sphere(triangles: int) -> MeshData:
    """A sphere of radius 1 about (0, 1.1, 0) with bumps, of about so many triangles."""
    rows = max(int((triangles / 4) ** 0.5), 2)
    columns = 2 * rows
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij"
    )
    r = 1 + 0.03 * np.sin(23 * theta) * np.sin(17 * phi)
    x, y, z = r * np.sin(theta) * np.cos(phi), 1.1 + r * np.cos(theta), r * np.sin(theta) * np.sin(phi)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)[None, :]).reshape(-1)
    below = first + columns + 1
    faces = np.concatenate(
        [np.stack([first, first + 1, below], 1), np.stack([first + 1, below + 1, below], 1)]
    )
    return MeshData(np.stack([x, y, z], -1).reshape(-1, 3), faces.astype(np.uint32))


def mesh_scene() -> Scene:
    """The bumpy sphere under a quad light and a sky."""
    return Scene.model_validate(
        {
            "version": 1,
            "camera": {
                "type": "perspective",
                "fov": 36,
                "transform": {"look_at": {"origin": [0, 2.4, 4.6], "target": [0, 0.9, 0]}},
            },
            "film": {"width": 320, "height": 240},
            "integrator": {"max_bounces": 4},
            "materials": {"grey": {"type": "diffuse", "base_color": [0.6, 0.6, 0.6]}},
            "shapes": [
                {"type": "plane", "material": "grey"},
                {"type": "mesh", "material": "grey", "source": {"asset": ANY_ASSET}},
                {
                    "type": "quad",
                    "origin": [-2, 4.5, 1.7],
                    "u": [1.6, 0, 0],
                    "v": [0, 0, 1.6],
                    "emission": {"radiance": 28},
                },
            ],
            "environment": {"type": "constant", "radiance": [0.3, 0.36, 0.46]},
        }
    )


def load(name: str) -> tuple[Scene, CompiledScene]:
    """A scene by its name in SCENES, ready for any device."""
    made = re.fullmatch(r"mesh-(\d+)k", name)
    if made:
        scene = mesh_scene()
        return scene, compile_scene(scene, OneMesh(bumpy_sphere(1000 * int(made.group(1)))))
    scene = Scene.model_validate_json((EXAMPLES / f"{name}.json").read_bytes())
    return scene, compile_scene(scene, NoAssets())


def measure(device: Device, scene: Scene, compiled: CompiledScene, samples: int) -> dict[str, Any]:
    """Seconds of the program's build, paths a second, and a hash of the sums."""
    count = max(samples // REPLICATES, 1)
    started = time.perf_counter()
    tracer = Tracer(device, compiled, SamplePlan(REPLICATES, 0))
    tile = Tile(0, 0, scene.film.width, scene.film.height)
    tracer.trace(Tile(0, 0, 1, 1), 0, 1)
    build = time.perf_counter() - started
    tracer.trace(tile, 0, count)
    seconds = []
    for _ in range(RUNS):
        started = time.perf_counter()
        node = tracer.trace(tile, 0, count)
        seconds.append(time.perf_counter() - started)
    paths = tile.width * tile.height * REPLICATES * count
    rgba: NDArray[Any] = np.ascontiguousarray(node.sums["rgba"])
    return {
        "build_seconds": round(build, 3),
        "paths_per_second": round(paths / min(seconds)),
        "rejected": int(node.sums["rejected"].sum()),
        "sums": hashlib.sha256(rgba.tobytes()).hexdigest()[:16],
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", action="append", help="default: every device")
    parser.add_argument("--trees", nargs="+", default=["wide", "compact"], choices=["wide", "compact"])
    parser.add_argument("--samples", type=int, default=64, help="a pixel")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for name in options.scenes:
        scene, compiled = load(name)
        for device_id in options.device or [info.id for info in devices()]:
            for tree in options.trees:
                row = measure(Device(device_id, tree), scene, compiled, options.samples)
                rows.append({"scene": name, "device": device_id, "tree": tree, **row})
                print(
                    f"{name:16} {device_id:10} {tree:8} {row['paths_per_second'] / 1e6:9.2f} M paths/s  "
                    f"build {row['build_seconds']:6.2f} s  rejected {row['rejected']}  sums {row['sums']}",
                    flush=True,
                )
            sums = {row["sums"] for row in rows if row["scene"] == name and row["device"] == device_id}
            if len(sums) > 1:
                print(f"{name}: the layouts differ on {device_id}")
    if options.json:
        named = {info.id: f"{info.name}, {info.platform_version}, {info.driver}" for info in devices()}
        options.json.write_text(json.dumps({"devices": named, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
