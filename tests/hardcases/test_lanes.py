"""Sixteen paths at once give the bits of paths taken alone: every example on a CPU's lanes, and as a GPU's threads take it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.parse import scene_from_json
from penumbra_service.images.assets import FolderAssets

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.json"))
SIDE = 24
TILE = Tile(3, 5, 19, 13)


@pytest.fixture(scope="module")
def devices(device: Device) -> tuple[Device, Device]:
    """The CPU's own way, and a path at a time through the compact tree."""
    return device, Device(device.info.id, "compact")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_sixteen_paths_are_sixteen_times_one(
    path: Path, devices: tuple[Device, Device], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """With 1, 2, 4 ... samples a pixel, which share lanes with their neighbours', and with more than there are lanes."""
    document = json.loads(path.read_text())
    document["film"] = {"width": SIDE, "height": SIDE}
    document["sampler"] = {"type": "sobol", "seed": 5}
    scene = scene_from_json(document, allow_files=True)
    compiled = compile_scene(scene, FolderAssets(tmp_path_factory.mktemp("assets"), path.parent))
    own, alone = (Tracer(device, compiled, SamplePlan(3), program="generic") for device in devices)
    for first, count in ((0, 1), (2, 2), (4, 4), (8, 8), (32, 32)):
        sixteen, one = own.trace(TILE, first, count).sums, alone.trace(TILE, first, count).sums
        assert sixteen.tobytes() == one.tobytes()
    assert sixteen["rays"].sum() > 0
