"""Renders one small picture of a scene on oclgrind's simulated device: `python oclgrind_render.py SCENE TREE`.

tests/hardcases/test_oclgrind.py runs it in a process of its own with the environment that oclgrind needs.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene
from penumbra_service.images.assets import FolderAssets

SIDE, SAMPLES, REPLICATES, BOUNCES = 3, 2, 2, 4


def small(document: dict) -> dict:
    """The scene with a picture of a few pixels and short paths: every effect stays in."""
    film = {**document.get("film", {}), "width": SIDE, "height": SIDE}
    film.pop("crop", None)
    integrator = document.get("integrator", {})
    bounces = min(integrator.get("max_bounces", BOUNCES), BOUNCES)
    return {**document, "film": film, "integrator": {**integrator, "max_bounces": bounces}}


def main(path: Path, tree: str) -> None:
    scene = Scene.model_validate(small(json.loads(path.read_text())))
    with tempfile.TemporaryDirectory() as kept:
        compiled = compile_scene(scene, FolderAssets(Path(kept), path.parent))
    replicates = 1 if scene.sampler.type == "regular" else REPLICATES
    tracer = Tracer(Device("oclgrind:0", tree), compiled, SamplePlan(replicates, SAMPLES))
    node = tracer.trace(Tile(0, 0, SIDE, SIDE), 0, SAMPLES)
    print(json.dumps({name: int(node.sums[name].sum()) for name in ("taken", "rejected")}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
