"""A picture that the clock had stopped comes again with the same bits, from its receipt; other receipts are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import OpenImageIO
import pytest
from penumbra_scene.job import JobRequest, StopReason
from penumbra_scene.parse import parse_scene
from penumbra_scene.receipt import Receipt
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


def _rendered(folder: Path, **sections: Any) -> Receipt:
    (folder / "scene.json").write_text(json.dumps({**SCENE, **sections}))
    scene = parse_scene((folder / "scene.json").read_bytes(), allow_files=True)
    (receipt,) = render(JobRequest(scene=scene), folder, folder, DEVICES[0].id, lambda event: None)
    return receipt


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("first")
    assert _rendered(folder).stop_reason is StopReason.SECONDS
    return folder


def _assert_same_again(folder: Path, again: Path) -> Receipt:
    again.mkdir()
    receipt, doubts = replay(folder / "receipt.json", folder / "scene.json", again, DEVICES[0].id)
    old = json.loads((folder / "receipt.json").read_text())
    assert doubts == []
    assert receipt.samples == old["samples"]
    assert receipt.scene_hash == old["scene_hash"]
    assert _channels(again / "result.exr") == _channels(folder / "result.exr")
    return receipt


def test_a_picture_that_the_clock_stopped_has_the_same_bits_again(first: Path, tmp_path: Path) -> None:
    _assert_same_again(first, tmp_path / "again")


@pytest.mark.parametrize("way", [{}, {"mode": "fast"}, {"strategy": "contrast", "threshold": 0.02}])
def test_an_adaptive_picture_has_the_same_bits_again_without_its_pilot(
    tmp_path: Path, way: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A window that cuts through blocks, ended by the clock: neither the map nor the end is in the scene."""
    monkeypatch.setattr("penumbra_service.engine.stages.spreading_pays", lambda *_: True)  # there is a map
    film = {"width": 64, "height": 48, "crop": {"x": 13, "y": 7, "width": 40, "height": 33}}
    old = _rendered(tmp_path, adaptive=way, film=film)
    assert old.stop_reason is StopReason.SECONDS
    assert old.adaptive is not None
    assert len(old.adaptive.levels) > 1
    new = _assert_same_again(tmp_path, tmp_path / "again")
    assert new.adaptive is not None
    assert new.adaptive.pilot_seconds == 0
    assert new.adaptive.map == old.adaptive.map
    assert (new.adaptive.biased, new.adaptive.levels) == (old.adaptive.biased, old.adaptive.levels)


def test_samples_of_a_pilot_that_the_clock_ended_keep_their_strata(tmp_path: Path) -> None:
    """They were planned for more than there are; the picture begins with them."""
    way = {"mode": "fast", "pilot_samples": 4096}
    large = {"width": 160, "height": 128}  # no machine takes the whole pilot in a tenth of the time
    old = _rendered(tmp_path, adaptive=way, film=large, sampler={"type": "jittered"}, stop={"seconds": 1})
    assert old.adaptive is not None
    assert old.adaptive.map is not None
    assert 0 < old.adaptive.map.kept < old.adaptive.map.kept_planned
    _assert_same_again(tmp_path, tmp_path / "again")


def test_a_receipt_without_its_map_and_one_with_a_broken_map_are_refused(tmp_path: Path) -> None:
    _rendered(tmp_path, adaptive={}, stop={"samples": 64})
    path = tmp_path / "receipt.json"
    receipt = json.loads(path.read_text())
    for broken, message in (
        (None, "does not hold that map"),
        ({**receipt["adaptive"]["map"], "rows": 5}, "5 x 16 blocks, where the picture has 12 x 16"),
        ({**receipt["adaptive"]["map"], "levels": "AAAA"}, "map of samples cannot be read"),
        ({**receipt["adaptive"]["map"], "shadow_rays": 10**9}, "1000000000 shadow rays: accepted are up to"),
        ({**receipt["adaptive"]["map"], "kept_shadow_rays": [2, 1]}, "2 shadow rays: accepted are up to"),
    ):
        path.write_text(json.dumps({**receipt, "adaptive": {**receipt["adaptive"], "map": broken}}))
        with pytest.raises(CommandError, match=message):
            replay(path, tmp_path / "scene.json", tmp_path / "again", DEVICES[0].id)


def test_the_receipt_of_another_scene_is_refused(first: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**SCENE, "sampler": {"type": "stratified", "seed": 12}}))
    with pytest.raises(CommandError, match="the receipt is of another scene"):
        replay(first / "receipt.json", other, tmp_path)


def test_what_is_no_receipt_is_refused(first: Path, tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="is no receipt"):
        replay(first / "scene.json", first / "scene.json", tmp_path)
