"""`make demo`, without its set-up: the service comes up, renders as for any client, and is gone afterwards."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from penumbra_scene.receipt import Receipt

ROOT = Path(__file__).resolve().parents[2]
SCENE = {
    "version": 1,
    "camera": {"type": "perspective", "transform": {"translate": [0, 0, 5]}},
    "film": {"width": 16, "height": 16},
    "stop": {"samples": 16},
    "shapes": [{"type": "sphere"}],
    "environment": {"type": "constant"},
}


def _demo(scene: Path, out: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, ROOT / "scripts" / "demo.py", scene, "--out", out]
    return subprocess.run(command, capture_output=True, text=True, timeout=250, check=False)


def test_the_demonstration_leaves_its_results_and_no_service(tmp_path: Path) -> None:
    scene, out = tmp_path / "scene.json", tmp_path / "out"
    scene.write_text(json.dumps(SCENE))
    result = _demo(scene, out)
    assert result.returncode == 0, result.stderr
    receipt = Receipt.model_validate_json((out / "receipt.json").read_bytes())
    assert receipt.samples == 16
    for name in ("result.exr", "thumbnail.png", "heatmap.png", "receipt.json"):
        assert str(out / name) in result.stdout
    assert re.search(r"16 samples a pixel in .* relative error [\d.e-]+ %", result.stdout)
    address = re.search(r"http://127\.0\.0\.1:\d+", result.stdout)
    assert address is not None
    with pytest.raises(httpx.ConnectError):
        httpx.get(address.group())


def test_a_scene_that_is_wrong_ends_the_demonstration_with_its_place(tmp_path: Path) -> None:
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({**SCENE, "film": {"width": 0}}))
    result = _demo(scene, tmp_path / "out")
    assert result.returncode == 1
    assert "/film/width" in result.stderr
    assert "Traceback" not in result.stderr
