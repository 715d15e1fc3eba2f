"""A picture that the clock had stopped comes again with the same bits, from its receipt; other receipts are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import OpenImageIO
import pytest
from penumbra_scene.job import JobRequest, StopReason
from penumbra_scene.parse import parse_scene
from penumbra_service.commands import CommandError
from penumbra_service.engine.local import list_devices
from penumbra_service.rendering import render
from penumbra_service.replay import replay

DEVICES = list_devices()
pytestmark = pytest.mark.skipif(not DEVICES, reason="no OpenCL device")
SCENE: dict[str, Any] = {
    "version": 1,
    "name": "ball",
    "camera": {"type": "perspective", "transform": [{"translate": [0, 0.5, 3]}]},
    "film": {"width": 32, "height": 24},
    "sampler": {"type": "stratified", "seed": 11},
    "stop": {"seconds": 0.5},
    "materials": {"white": {"type": "diffuse", "base_color": 0.6}},
    "shapes": [{"type": "sphere", "material": "white", "transform": [{"scale": 0.5}]}],
    "environment": {"type": "constant", "radiance": 1.0},
}


def _channels(path: Path) -> dict[str, bytes]:
    file = OpenImageIO.ImageInput.open(str(path))
    channels: dict[str, bytes] = {}
    part = 0
    while file.seek_subimage(part, 0):
        names = file.spec().channelnames
        pixels = file.read_image(part, 0, 0, len(names), OpenImageIO.UNKNOWN)
        channels |= {name: pixels[..., i].tobytes() for i, name in enumerate(names)}
        part += 1
    file.close()
    return channels


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("first")
    (folder / "scene.json").write_text(json.dumps(SCENE))
    scene = parse_scene((folder / "scene.json").read_bytes(), allow_files=True)
    (receipt,) = render(JobRequest(scene=scene), folder, folder, DEVICES[0].id, lambda event: None)
    assert receipt.stop_reason is StopReason.SECONDS
    return folder


def test_a_picture_that_the_clock_stopped_has_the_same_bits_again(first: Path, tmp_path: Path) -> None:
    again, doubts = replay(first / "receipt.json", first / "scene.json", tmp_path, DEVICES[0].id)
    old = json.loads((first / "receipt.json").read_text())
    assert doubts == []
    assert again.samples == old["samples"]
    assert _channels(tmp_path / "result.exr") == _channels(first / "result.exr")


def test_the_receipt_of_another_scene_is_refused(first: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**SCENE, "sampler": {"type": "stratified", "seed": 12}}))
    with pytest.raises(CommandError, match="the receipt is of another scene"):
        replay(first / "receipt.json", other, tmp_path)


def test_what_is_no_receipt_is_refused(first: Path, tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="is no receipt"):
        replay(first / "scene.json", first / "scene.json", tmp_path)
