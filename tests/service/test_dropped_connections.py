"""A database whose connections drop while a job renders: the job ends all the same, with the bits of an undisturbed run."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import OpenImageIO
import pytest
from fastapi.testclient import TestClient
from penumbra_service.app import create_app
from penumbra_service.engine.local import LocalEngine
from penumbra_service.local_runner import LocalRunner
from penumbra_service.settings import Settings

FAKE = Path(__file__).parent / "engine" / "fake_device.py"
SCENE: dict[str, Any] = {
    "version": 1,
    "name": "steady",
    "camera": {"type": "perspective"},
    "film": {"width": 128, "height": 128},
    "sampler": {"type": "independent"},
    "stop": {"samples": 512},
}
SECONDS = 120.0


@pytest.fixture
def client(postgres_url: str, tmp_path: Path) -> Iterator[TestClient]:
    settings = Settings(data=tmp_path / "data", database_url=postgres_url, shutdown_seconds=5.0)
    runner = LocalRunner(settings, LocalEngine(command=(sys.executable, str(FAKE))))
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        yield client


def _wait(client: TestClient, job: str, wanted: Any) -> dict[str, Any]:
    end = time.monotonic() + SECONDS
    while True:
        assert time.monotonic() < end
        answer = client.get(f"/v1/jobs/{job}")
        if answer.status_code == 200:  # a request may meet the very connection that was dropped
            status: dict[str, Any] = answer.json()
            assert status["state"] not in ("failed", "cancelled"), status
            if wanted(status):
                return status
        time.sleep(0.05)


def _picture(client: TestClient, job: str, folder: Path) -> dict[str, bytes]:
    path = folder / f"{job}.exr"
    path.write_bytes(client.get(f"/v1/jobs/{job}/result.exr").content)
    file = OpenImageIO.ImageInput.open(str(path))
    channels: dict[str, bytes] = {}
    part = 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, OpenImageIO.UNKNOWN)
        channels |= {name: pixels[..., i].tobytes() for i, name in enumerate(spec.channelnames)}
        part += 1
    file.close()
    return channels


def test_a_job_survives_dropped_connections(
    client: TestClient, postgres_url: str, drop_connections: Callable[[str], int], tmp_path: Path
) -> None:
    plain = client.post("/v1/jobs", json={**SCENE, "name": "plain"}).json()["id"]
    _wait(client, plain, lambda status: status["state"] == "done")
    job = client.post("/v1/jobs", json=SCENE).json()["id"]
    for share in (0.1, 0.4, 0.7):
        _wait(client, job, lambda status, share=share: status["progress"] > share)
        assert drop_connections(postgres_url) > 0
    _wait(client, job, lambda status: status["state"] == "done")
    assert _picture(client, job, tmp_path) == _picture(client, plain, tmp_path)
