"""The main job, end to end: scene JSON over HTTP to an EXR with variance, on real devices in real processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from penumbra_scene.receipt import Receipt

OpenEXR = pytest.importorskip("OpenEXR")

FURNACE: dict[str, Any] = {
    "version": 1,
    "name": "a furnace",
    "camera": {"type": "perspective", "transform": [{"translate": [0, 0, 4]}]},
    "film": {"width": 40, "height": 30, "layers": ["albedo", "normal", "depth"]},
    "stop": {"samples": 64},
    "integrator": {"max_bounces": 64, "roulette_start": 64},
    "materials": {"white": {"type": "diffuse", "base_color": 1.0}},
    "shapes": [{"type": "sphere", "material": "white"}],
    "environment": {"type": "constant", "radiance": 0.5},
}
"""A white sphere in even light cannot be seen: every pixel has the expected value 0.5."""


Z_LIMIT = 6.0
"""Beyond the z of 4.9 that a false-alarm rate of 1e-6 asks for: the variance is an estimate, too."""


class Service:
    """`python -m penumbra_service` on a free port."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[str] | None = None
        self.client = httpx.Client(timeout=30)

    def start(self) -> None:
        environment = {**os.environ, "PENUMBRA_DATA": str(self._folder), "PENUMBRA_PORT": "0"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "penumbra_service"], stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert "http://" in line, line
        self.client.base_url = httpx.URL(line[line.index("http://") :].split()[0])

    def stop(self, how: signal.Signals = signal.SIGTERM) -> int:
        assert self._process is not None
        assert self._process.stdout is not None
        self._process.send_signal(how)
        code = self._process.wait(60)
        self._process.stdout.close()
        self._process = None
        return code

    def submit(self, scene: dict[str, Any]) -> dict[str, Any]:
        answer = self.client.post("/v1/jobs", json=scene)
        assert answer.status_code == 202, answer.text
        job: dict[str, Any] = answer.json()
        return job

    def wait(self, job_id: str, holds: Any, seconds: float = 240) -> dict[str, Any]:
        deadline = time.monotonic() + seconds
        while True:
            status: dict[str, Any] = self.client.get(f"/v1/jobs/{job_id}").json()
            if holds(status):
                return status
            assert status["state"] not in ("failed", "cancelled"), status
            assert time.monotonic() < deadline, status
            time.sleep(0.1)

    def picture(self, job: dict[str, Any], path: Path) -> Any:
        path.write_bytes(self.client.get(job["links"]["exr"]).raise_for_status().content)
        return OpenEXR.File(str(path), separate_channels=True)

    @property
    def running(self) -> bool:
        return self._process is not None


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    service = Service(tmp_path / "data")
    service.start()
    yield service
    if service.running:
        service.stop(signal.SIGKILL)
    service.client.close()


def channels(file: Any) -> dict[str, np.ndarray]:
    return {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}


def done(status: dict[str, Any]) -> bool:
    return bool(status["state"] == "done")


def test_a_furnace_comes_out_even_with_its_variance_and_receipt(service: Service, tmp_path: Path) -> None:
    job = service.submit(FURNACE)
    service.wait(job["id"], done)
    file = service.picture(job, tmp_path / "a.exr")
    found = channels(file)
    sphere = found["ID"] == 1
    for name in "RGB":
        variance = found[f"Variance.{name}"]
        # a pixel that sees nothing but the environment has no noise at all
        assert (found[name][found["A"] == 0] == 0.5).all()
        z = (found[name][sphere].mean() - 0.5) / (np.sqrt(variance[sphere].sum()) / sphere.sum())
        assert abs(z) < Z_LIMIT
        assert (variance[found["A"] == 0] == 0).all()
        assert (variance[sphere] > 0).any()
        np.testing.assert_allclose(found[f"StdErr.{name}"], np.sqrt(variance), rtol=1e-5)
    assert (found["SampleCount"] == 64).all()
    assert (found["InvalidCount"] == 0).all()
    assert found["ID"][15, 20] == 1
    assert found["ID"][0, 0] == 0
    # the sphere's front is 3 m from the camera, and shows its normal towards it
    assert found["Z"][15, 20] == pytest.approx(3, abs=0.01)
    assert found["N.Z"][15, 20] == pytest.approx(1, abs=0.01)
    assert found["Albedo.G"][15, 20] == pytest.approx(1, abs=1e-5)
    receipt = Receipt.model_validate_json(service.client.get(job["links"]["receipt"]).content)
    header = file.parts[0].header
    assert header["penumbra:seed"] == receipt.seed == "0"
    assert header["penumbra:sceneHash"] == receipt.scene_hash
    assert header["penumbra:replicates"] == receipt.replicates
    assert receipt.counts.taken == 64 * 40 * 30
    assert receipt.stop_reason == "samples"
    assert {"environment", "round"} <= {effect.name for effect in receipt.effects_in}
    assert {"lens", "motion", "transmission"} <= {effect.name for effect in receipt.effects_out}
    assert service.client.get(job["links"]["thumbnail"]).content.startswith(b"\x89PNG")
    assert service.client.get(job["links"]["heatmap"]).content.startswith(b"\x89PNG")
    assert service.stop() == 0


LONG: dict[str, Any] = {
    **FURNACE,
    "film": {"width": 160, "height": 120},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
    "shapes": [
        {"type": "sphere", "material": "gray"},
        {"type": "plane", "point": [0, -1, 0], "material": "gray"},
    ],
    "stop": {"samples": 12288},
}
"""Takes seconds."""


def test_a_killed_service_goes_on_and_its_picture_has_the_same_bits(service: Service, tmp_path: Path) -> None:
    """A pause leaves a snapshot, however fast the machine is; of those that time brings, tests/faults tells."""
    job = service.submit(LONG)
    work = tmp_path / "data" / "work" / job["id"]
    service.wait(job["id"], lambda status: status["progress"] > 0.05)
    service.client.post(f"/v1/jobs/{job['id']}/pause")
    service.wait(job["id"], lambda status: any((work / "tiles").glob("*")))
    service.client.post(f"/v1/jobs/{job['id']}/resume")
    service.wait(job["id"], lambda status: status["state"] == "rendering")
    service.stop(signal.SIGKILL)
    service.start()
    service.wait(job["id"], done)
    disturbed = channels(service.picture(job, tmp_path / "a.exr"))
    again = service.submit({**LONG, "name": "undisturbed"})
    service.wait(again["id"], done)
    undisturbed = channels(service.picture(again, tmp_path / "b.exr"))
    assert disturbed.keys() == undisturbed.keys()
    for name, pixels in disturbed.items():
        assert pixels.tobytes() == undisturbed[name].tobytes(), name


def test_a_crop_has_the_full_frames_bits(service: Service, tmp_path: Path) -> None:
    scene = {**LONG, "stop": {"samples": 32}, "film": {"width": 64, "height": 48}}
    crop = {"x": 13, "y": 7, "width": 30, "height": 21}
    jobs = [service.submit(scene), service.submit({**scene, "film": {**scene["film"], "crop": crop}})]
    whole, part = (channels(service.picture(service.wait(j["id"], done), tmp_path / "a.exr")) for j in jobs)
    for name in ("R", "G", "B", "Variance.R", "SampleCount"):
        np.testing.assert_array_equal(part[name], whole[name][7:28, 13:43])


def test_a_paused_job_lets_others_pass(service: Service) -> None:
    long = service.submit(LONG)
    service.wait(long["id"], lambda status: status["progress"] > 0.02)
    assert service.client.post(f"/v1/jobs/{long['id']}/pause").json()["state"] == "paused"
    short = service.submit({**FURNACE, "stop": {"samples": 8}})
    service.wait(short["id"], done)
    before = service.client.get(f"/v1/jobs/{long['id']}").json()
    assert before["state"] == "paused"
    service.client.post(f"/v1/jobs/{long['id']}/resume")
    status = service.wait(long["id"], lambda s: s["state"] == "rendering" and s["samples_done"] > 0)
    assert status["samples_done"] >= 0.5 * before["samples_done"]
    assert service.client.post(f"/v1/jobs/{long['id']}/cancel").json()["state"] == "cancelled"
    assert json.loads(service.client.get("/health").content)["status"] == "ok"
