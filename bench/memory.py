"""What a large mesh takes: memory of the process that holds it, of the one that builds its tree, and seconds.

    python bench/memory.py [--triangles 1000000]

What a device process of the service does, in a process of its own: a small scene is loaded and traced, which is the loaded
runtime; then the mesh, decoded already, is compiled with its tree built, uploaded and traced; and in a second process the same
with the tree found in the cache. Programs are cached. Megabytes are those of VmHWM, the peak of resident memory, files mapped
into it included; samples are traced until 64 and then until 1024, between which nothing may grow. Prints JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from meshes import knot

TILE: Final = 64
SAMPLES: Final = (64, 1024)
SMALL: Final[dict[str, Any]] = {
    "version": 1,
    "camera": {
        "type": "perspective",
        "fov": 40,
        "transform": {"look_at": {"origin": [0, 1, 3], "target": [0, 0, 0]}},
    },
    "film": {"width": TILE, "height": TILE},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.6}},
    "shapes": [
        {"type": "plane", "point": [0, -1, 0], "material": "gray"},
        {"type": "quad", "origin": [-1, 3, -1], "u": [2, 0, 0], "v": [0, 0, 2], "emission": {"radiance": 5}},
    ],
}
MESH: Final = {"type": "mesh", "source": {"file": "mesh"}, "material": "gray"}


def peak(process: int | str = "self") -> float:
    """Megabytes, of the process so far."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def child(folder: Path) -> dict[str, Any]:
    """One process' life."""
    from penumbra_kernels.accel.apart import TreeBuilder
    from penumbra_kernels.accel.trees import Trees
    from penumbra_kernels.assets import MeshData
    from penumbra_kernels.compile.scene import compile_scene
    from penumbra_kernels.device import Device
    from penumbra_kernels.nodes import Tile
    from penumbra_kernels.tracer import SamplePlan, Tracer
    from penumbra_scene.scene import Scene

    class Held:
        """As the service's decoded assets: mapped, and let go of after use."""

        def image(self, ref: Any) -> Any:
            raise NotImplementedError

        def mesh(self, ref: Any) -> MeshData:
            return MeshData(
                *(np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("positions", "indices"))
            )

    def traced(scene: dict[str, Any], samples: int = 1) -> Tracer:
        compiled = compile_scene(Scene.model_validate(scene), Held(), trees=trees)
        tracer = Tracer(device, compiled, SamplePlan(8), keep_arrays=False)
        tracer.trace(Tile(0, 0, TILE, TILE), 0, samples)
        return tracer

    builder = TreeBuilder()
    trees = Trees(build_large=builder)
    device = Device()
    traced(SMALL)
    found = {"runtime": peak()}
    started = time.perf_counter()
    tracer = traced({**SMALL, "shapes": [*SMALL["shapes"], MESH]})
    found["seconds"] = time.perf_counter() - started
    found["holder"] = peak()
    process = builder._process
    found["builder"] = 0.0 if process is None else peak(process.pid)
    found["bytes_a_triangle"] = tracer.scene_bytes / tracer.compiled.triangle_count
    builder.close()
    for samples in SAMPLES:
        tracer.trace(Tile(0, 0, TILE, TILE), 0, samples // 8)
        found[f"after_{samples}_samples"] = peak()
    return found


def measure(triangles: int) -> dict[str, Any]:
    """Megabytes and seconds: with the tree built, and with it found."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        positions, indices = knot(triangles)
        np.save(folder / "positions.npy", positions.astype(np.float64))
        np.save(folder / "indices.npy", indices)
        environment = os.environ | {"PENUMBRA_CACHE": str(folder / "cache"), "OPENBLAS_NUM_THREADS": "1"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # numba's code is kept beside it

        def run() -> dict[str, Any]:
            command = [sys.executable, __file__, "--child", name]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            return dict(json.loads(done.stdout))

        np.save(folder / "positions.npy", positions[:1].astype(np.float64))
        np.save(folder / "indices.npy", np.zeros((1, 3), np.uint32))
        run()  # programs are cached by one that is not counted
        np.save(folder / "positions.npy", positions.astype(np.float64))
        np.save(folder / "indices.npy", indices)
        return {"triangles": len(indices), "built": rounded(run()), "found": rounded(run())}


def rounded(found: dict[str, Any]) -> dict[str, float]:
    return {name: round(value, 2 if name == "seconds" else 1) for name, value in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--triangles", type=int, default=1_000_000)
    parser.add_argument("--child", type=Path, help="folder with a mesh: what `measure` starts")
    options = parser.parse_args()
    print(json.dumps(measure(options.triangles) if options.child is None else child(options.child)))


if __name__ == "__main__":
    main()
