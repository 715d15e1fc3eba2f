"""Sixteen paths at once give the bits of paths taken alone: every example on a CPU's lanes, and as a GPU's threads take it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

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
NODES = ((0, 1, TILE), (2, 2, TILE), (4, 4, TILE), (8, 8, TILE), (32, 32, TILE), (256, 256, Tile(9, 7, 2, 2)))


@pytest.fixture(scope="module")
def devices(device: Device) -> tuple[Device, Device]:
    """The CPU's own way, and a path at a time through the compact tree."""
    return device, Device(device.info.id, "compact")


def _assert_alike(
    document: dict[str, Any], devices: tuple[Device, Device], assets: FolderAssets, program: str
) -> None:
    """With 1, 2, 4 ... samples a pixel, which share lanes with their neighbours', with more than there are lanes, and with more
    than a batch takes."""
    document["film"] = {"width": SIDE, "height": SIDE}
    compiled = compile_scene(scene_from_json(document, allow_files=True), assets)
    own, alone = (Tracer(device, compiled, SamplePlan(3, 64), program=program) for device in devices)
    for first, count, tile in NODES:
        sixteen, one = own.trace(tile, first, count).sums, alone.trace(tile, first, count).sums
        assert sixteen.tobytes() == one.tobytes()
    assert sixteen["rays"].sum() > 0


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_sixteen_paths_are_sixteen_times_one(
    path: Path, devices: tuple[Device, Device], tmp_path_factory: pytest.TempPathFactory
) -> None:
    document = json.loads(path.read_text())
    document["sampler"] = {"type": "sobol", "seed": 5}
    _assert_alike(document, devices, FolderAssets(tmp_path_factory.mktemp("assets"), path.parent), "generic")


@pytest.mark.parametrize("lights", ["one", "all"])
def test_so_they_are_in_flight_through_large_trees(
    lights: str, devices: tuple[Device, Device], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The last ray of a hit to a light waits for those of all vectors, others do not."""
    path = EXAMPLES[0].parent / "big_mesh.json"
    document = json.loads(path.read_text())
    document["integrator"] = {"max_bounces": 6, "roulette_start": 2, "shadow_rays": 2}
    document["integrator"]["light_selection"] = "power" if lights == "one" else "all"
    assets = FolderAssets(tmp_path_factory.mktemp("assets"), path.parent)
    _assert_alike(document, devices, assets, "specialised")


@pytest.mark.parametrize(
    "integrator", [{}, {"shadow_rays": 3, "light_selection": "all"}], ids=["one", "many"]
)
@pytest.mark.parametrize(
    "sampler", ["regular", "independent", "stratified", "jittered", "sobol", "blue_noise"]
)
def test_so_they_are_with_every_sampler(
    sampler: str,
    integrator: dict[str, Any],
    devices: tuple[Device, Device],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Some lanes draw a number and others none, as their paths call for."""
    document = json.loads((EXAMPLES[0].parent / "cornell.json").read_text())
    document["sampler"] = {"type": sampler, "seed": 3}
    document["integrator"] = {"max_bounces": 5, "roulette_start": 1, **integrator}
    _assert_alike(
        document, devices, FolderAssets(tmp_path_factory.mktemp("assets"), EXAMPLES[0].parent), "specialised"
    )
