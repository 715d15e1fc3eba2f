"""Jobs of several frames over HTTP, on device processes without OpenCL."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from penumbra_scene.job import FramePage, FrameStatus, JobStatus
from penumbra_scene.receipt import Receipt
from penumbra_service.app import create_app
from penumbra_service.engine.local import LocalEngine
from penumbra_service.images.movie import movie_program
from penumbra_service.images.png import read_png
from penumbra_service.local_runner import LocalRunner
from penumbra_service.settings import Settings

OpenEXR = pytest.importorskip("OpenEXR")
FAKE = Path(__file__).parents[1] / "engine" / "fake_device.py"


class Farm:
    """A service on fake devices."""

    def __init__(self, client: TestClient, engine: LocalEngine) -> None:
        self.client = client
        self.engine = engine

    def submit(self, **job: Any) -> JobStatus:
        answer = self.client.post("/v1/jobs", json=job)
        assert answer.status_code == 202, answer.text
        return JobStatus.model_validate_json(answer.content)

    def job(self, job: JobStatus) -> JobStatus:
        return JobStatus.model_validate_json(self.client.get(job.links.self).content)

    def frames(self, job: JobStatus) -> dict[int, FrameStatus]:
        page = FramePage.model_validate_json(self.client.get(f"{job.links.self}/frames").content)
        return {frame.number: frame for frame in page.items}

    def until(self, job: JobStatus, holds: Callable[[JobStatus], bool]) -> JobStatus:
        deadline = time.monotonic() + 60
        while not holds(status := self.job(job)):
            assert time.monotonic() < deadline, status
            time.sleep(0.02)
        return status

    def picture(self, path: str, folder: Path) -> dict[str, bytes]:
        """Every channel of an EXR, as bytes."""
        (folder / "a.exr").write_bytes(self.client.get(path).raise_for_status().content)
        file = OpenEXR.File(str(folder / "a.exr"), separate_channels=True)
        return {name: c.pixels.tobytes() for part in file.parts for name, c in part.channels.items()}


@contextmanager
def farm_at(data: Path) -> Iterator[Farm]:
    engine = LocalEngine(command=("env", "FAKE_DEVICES=fake:0,fake:1", sys.executable, str(FAKE)))
    settings = Settings(data=data, heartbeat_seconds=1.0)
    with TestClient(
        create_app(settings, LocalRunner(settings, engine)), base_url="http://127.0.0.1"
    ) as client:
        yield Farm(client, engine)


@pytest.fixture
def farm(tmp_path: Path) -> Iterator[Farm]:
    with farm_at(tmp_path / "data") as farm:
        yield farm


def moving(scene: dict[str, Any], name: str = "a film", samples: int = 16) -> dict[str, Any]:
    keyframes = [{"time": float(t), "transform": [{"translate": [t, 0, 0]}]} for t in (0, 1)]
    return {
        **scene,
        "name": name,
        "film": {"width": 72, "height": 64},
        "sampler": {"type": "independent"},
        "stop": {"samples": samples},
        "camera": {"type": "perspective", "transform": {"keyframes": keyframes}},
    }


def done(status: JobStatus) -> bool:
    assert status.state.value != "failed", status.problem
    return status.state.value == "done"


def test_frames_appear_as_they_finish_and_equal_single_ones(
    farm: Farm, scene: dict[str, Any], tmp_path: Path
) -> None:
    job = farm.submit(scene=moving(scene), frames="2-8x2", fps=2.0)
    assert job.frames is not None
    assert job.frames.total == 4
    assert job.links.frames == f"{job.links.self}/frames"
    status = farm.until(job, done)
    assert status.frames is not None
    assert (status.frames.done, status.progress, status.samples_done) == (4, 1.0, 16.0)
    frames = farm.frames(job)
    assert list(frames) == [2, 4, 6, 8]
    assert [frame.time for frame in frames.values()] == [1.0, 2.0, 3.0, 4.0]
    single = farm.submit(scene=moving(scene), frames="4", fps=2.0)
    farm.until(single, done)
    assert farm.picture(frames[4].links.exr, tmp_path) == farm.picture(single.links.exr, tmp_path)
    receipt = Receipt.model_validate_json(farm.client.get(frames[6].links.receipt).content)
    assert (receipt.frame, receipt.time, receipt.samples) == (6, 3.0, 16.0)
    for frame in frames.values():
        assert frame.state.value == "done"
        assert frame.stop_reason is not None
        assert frame.finished is not None
        assert frame.finished >= frame.started  # type: ignore[operator]
        assert farm.client.get(frame.links.heatmap).headers["content-type"] == "image/png"
        one = farm.client.get(frame.links.self).json()
        assert one == json.loads(frame.model_dump_json())
    sheet = tmp_path / "sheet.png"
    assert job.links.contact_sheet is not None
    sheet.write_bytes(farm.client.get(job.links.contact_sheet).raise_for_status().content)
    assert np.ptp(read_png(sheet)) > 0
    assert farm.client.get(job.links.thumbnail).status_code == 200
    assert job.links.movie is not None
    film = farm.client.get(job.links.movie)
    if movie_program() is None:
        assert (film.status_code, "no ffmpeg" in film.json()["detail"]) == (404, True)
    else:
        assert film.headers["content-type"] == "video/mp4"
    answer = farm.client.get(job.links.page)
    page = answer.text
    assert (f'<video src="{job.links.movie}"' in page) == (movie_program() is not None)
    assert "media-src 'self'" in answer.headers["content-security-policy"]
    assert 'id="frame-8"' in page
    assert job.links.contact_sheet in page


def test_what_is_not_there_says_why(farm: Farm, scene: dict[str, Any]) -> None:
    job = farm.submit(scene=moving(scene, "slow film", 256), frames="1-3")
    single = farm.submit(scene=moving(scene))
    base = job.links.self
    for path, detail in (
        (f"{base}/result.exr", "each of its frames has its own"),
        (f"{base}/frames/7", "it has 1-3"),
        (f"{base}/frames/7/result.exr", "it has 1-3"),
        (f"{base}/frames/3/result.exr", "frame 3"),
        (f"{single.links.self}/frames/1", "single picture"),
        (f"{single.links.self}/contact_sheet.png", "single picture"),
    ):
        answer = farm.client.get(path)
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"
        assert detail in answer.json()["detail"]
    assert farm.client.get(f"{base}/frames/-1").status_code == 422
    assert farm.client.get(f"{single.links.self}/frames").json() == {"items": [], "next": None}
    assert farm.client.post(f"{base}/cancel").json()["state"] == "cancelled"
    assert {frame.state.value for frame in farm.frames(job).values()} == {"cancelled"}


def test_frames_come_in_pages(farm: Farm, scene: dict[str, Any]) -> None:
    job = farm.submit(scene=moving(scene), frames="1-9x2", priority=-1)
    first = farm.client.get(f"{job.links.self}/frames", params={"limit": 3}).json()
    assert ([f["number"] for f in first["items"]], first["next"]) == ([1, 3, 5], 5)
    rest = farm.client.get(f"{job.links.self}/frames", params={"limit": 3, "after": 5}).json()
    assert ([f["number"] for f in rest["items"]], rest["next"]) == ([7, 9], None)


def test_a_paused_sequence_goes_on_where_it_was(farm: Farm, scene: dict[str, Any], tmp_path: Path) -> None:
    job = farm.submit(scene=moving(scene, "slow film", 64), frames="1-4")
    farm.until(job, lambda s: s.frames is not None and s.frames.done >= 1)
    assert farm.client.post(f"{job.links.self}/pause").json()["state"] == "paused"
    deadline = time.monotonic() + 20
    while farm.engine.devices()[0].state.value == "busy":
        assert time.monotonic() < deadline
        time.sleep(0.02)
    before = farm.frames(job)
    ended = {n: f.finished for n, f in before.items() if f.state.value == "done"}
    assert 1 <= len(ended) < 4
    assert {f.state.value for f in before.values()} == {"done", "paused"}
    farm.client.post(f"{job.links.self}/resume")
    farm.until(job, done)
    after = farm.frames(job)
    assert {n: after[n].finished for n in ended} == ended
    plain = farm.submit(scene=moving(scene, "film", 64), frames="3")
    farm.until(plain, done)
    assert farm.picture(after[3].links.exr, tmp_path) == farm.picture(plain.links.exr, tmp_path)


def test_a_restart_keeps_frames_that_are_done(scene: dict[str, Any], tmp_path: Path) -> None:
    with farm_at(tmp_path / "data") as farm:
        job = farm.submit(scene=moving(scene, "slow film", 64), frames="1-4")
        farm.until(job, lambda s: s.frames is not None and s.frames.done >= 1)
    with farm_at(tmp_path / "data") as farm:
        finished = {n: f.finished for n, f in farm.frames(job).items() if f.finished is not None}
        assert finished
        farm.until(job, done)
        frames = farm.frames(job)
        assert {n: frames[n].finished for n in finished} == finished
        sheet = tmp_path / "sheet.png"
        sheet.write_bytes(farm.client.get(f"{job.links.self}/contact_sheet.png").content)
        pixels = read_png(sheet)
        assert not (pixels.reshape(-1, 3) == (48, 48, 52)).all(axis=1).any()  # no frame is missing
        folder = farm.client.app.state.service.work_folder(job.id)  # type: ignore[attr-defined]
        farm.until(job, lambda _: not folder.exists())


def test_a_killed_device_costs_a_frame_nothing(farm: Farm, scene: dict[str, Any], tmp_path: Path) -> None:
    job = farm.submit(scene=moving(scene, "slow film", 64), frames="1-3")
    slot = farm.engine._slots[0] if farm.engine._slots else None
    deadline = time.monotonic() + 20
    while slot is None or slot.running is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
        slot = farm.engine._slots[0] if farm.engine._slots else None
    assert slot.process is not None
    os.kill(slot.process.pid, signal.SIGKILL)
    farm.until(job, done)
    plain = farm.submit(scene=moving(scene, "film", 64), frames="1")
    farm.until(plain, done)
    exr = farm.frames(job)[1].links.exr
    assert farm.picture(exr, tmp_path) == farm.picture(plain.links.exr, tmp_path)


def test_a_scene_that_fails_fails_its_frames_and_the_job(farm: Farm, scene: dict[str, Any]) -> None:
    job = farm.submit(scene=moving(scene, "bad-scene"), frames="1-20")
    status = farm.until(job, lambda s: s.state.ended)
    assert status.state.value == "failed"
    assert status.problem is not None
    assert "upload it first" in status.problem.detail
    assert status.frames is not None
    assert 3 <= status.frames.failed < 20
    failed = next(f for f in farm.frames(job).values() if f.state.value == "failed")
    assert failed.problem is not None


def test_the_same_sequence_twice_is_one_job(farm: Farm, scene: dict[str, Any]) -> None:
    body = {"scene": moving(scene), "frames": "1-3"}
    headers = {"Idempotency-Key": "film"}
    ids = {farm.client.post("/v1/jobs", json=body, headers=headers).json()["id"] for _ in range(2)}
    assert len(ids) == 1
    other = farm.client.post("/v1/jobs", json={**body, "frames": "1-4"}, headers=headers)
    assert other.status_code == 409
