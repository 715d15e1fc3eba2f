"""A real service on a real socket whose runner draws small pictures step by step; a browser to look at it."""

from __future__ import annotations

import json
import os
import shutil
import struct
import threading
import time
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from penumbra_scene.errors import ProblemError, make_problem
from penumbra_scene.job import DeviceState, DeviceStatus, JobRequest, JobState, StopReason
from penumbra_scene.quote import Quote
from penumbra_service.api.openapi import QUOTE_ANSWER
from penumbra_service.app import create_app
from penumbra_service.results import HEATMAP, RECEIPT, RESULT, THUMBNAIL
from penumbra_service.running import Outcome, Task
from penumbra_service.service import RenderService
from penumbra_service.settings import Settings

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
STAGES = ("queue", "compile", "build", "trace", "write")
SCENE: dict[str, Any] = {
    "version": 1,
    "name": "two balls",
    "camera": {"type": "perspective"},
    "film": {"width": 160, "height": 120},
    "stop": {"relative_error": 0.02},
    "shapes": [{"type": "quad", "emission": {"radiance": 1}}],
}


def png(width: int, height: int, step: int) -> bytes:
    """A picture that looks different at each step."""
    rows = bytearray()
    for y in range(height):
        rows.append(0)
        for x in range(width):
            near = (x - width / 2) ** 2 + (y - height / 2) ** 2 < (8 + 5 * step) ** 2
            rows += bytes((230, 140, 40) if near else (40 + y // 2, 50 + y // 2, 80 + x // 4))

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(bytes(rows)))
        + chunk(b"IEND", b"")
    )


def error_at(step: int) -> dict[str, Any]:
    """Where the error stands after a step: it falls as the root of the samples, from 16 %."""
    error = 0.16 * 2 ** (-step / 2)
    interval = {"low": 0.9 * error, "high": 1.15 * error, "confidence": 0.95}
    return {
        "samples": 8.0 * 2**step,
        "seconds": 0.3 * 2**step,
        "relmse": error**2,
        "relative_error": error,
        "relative_error_interval": interval,
    }


def receipt_of(task: Task, steps: int) -> str:
    """A receipt with something under every heading."""
    scene = task.request.resolved_scene()
    last = error_at(steps)
    stage = {"seconds": 0.4, "warm": True}
    receipt = {
        "job": task.job_id, "name": scene.name,
        "created": str(task.created), "finished": str(datetime.now(UTC)),
        "versions": {"penumbra-render": "0.1.0", "pocl": "3.0"}, "scene_hash": "sha256:" + "ab" * 32,
        "film": {"width": scene.film.width, "height": scene.film.height, "filter": {"type": "box"}},
        "sampler": "sobol", "seed": "0", "replicates": 8, "samples": last["samples"],
        "stop": scene.stop.model_dump(mode="json"), "stop_reason": "relative_error",
        "stages": {**dict.fromkeys(STAGES, stage), "wall_seconds": 12.5},
        "error": {
            "relmse": last["relmse"], "relative_error": last["relative_error"], "mse": 1e-4, "theta": 1.02,
            "method": "spread of 8 replicates", "curve": [error_at(i) for i in range(1, steps + 1)],
        },
        "forecast": {"at_samples": 64, "predicted_samples": 500, "predicted_seconds": 20, "real_samples": 512,
                     "real_seconds": 19.2},
        "counts": {"taken": 9830400, "lit": 9000000, "rejected": 0, "pixels": 19200, "flagged_pixels": 12},
        "effects_in": [{"name": "area lights", "reason": "shapes/0 emits"}],
        "effects_out": [{"name": "lens", "reason": "the aperture is closed"}],
        "devices": [{"id": "fake-0", "name": "Fake", "platform": "None", "driver": "1", "bit_class": "abc"}],
        "bit_class": "abc",
    }  # fmt: skip
    return json.dumps(receipt)


QUOTE = Quote.model_validate(QUOTE_ANSWER["content"]["application/json"]["example"])


class SteppingRunner:
    """Renders as far as `let(n)` allows, in STEPS steps; then fails if told to."""

    STEPS = 6
    problem: str | None = None

    def __init__(self) -> None:
        self._allowed = threading.Semaphore(0)
        self.fail = False

    def let(self, steps: int = STEPS) -> None:
        for _ in range(steps):
            self._allowed.release()

    def start(self) -> None:
        """Nothing to start."""

    def stop(self) -> None:
        """Nothing to stop."""

    def quote(self, request: JobRequest, folder: Path) -> Quote:
        if self.fail:
            raise ProblemError(make_problem("job-device", "There is no device to render on", 503, "none"))
        (folder / "scene.json").write_text("{}")
        return QUOTE.model_copy(update={"name": request.scene.name})

    def devices(self) -> list[DeviceStatus]:
        return [
            DeviceStatus(
                id="fake-0", name="A device of this test", platform="None", kind="cpu", compute_units=2,
                memory_bytes=8 << 30, state=DeviceState.IDLE,
            )
        ]  # fmt: skip

    def run(self, task: Task) -> Outcome:
        curve: list[dict[str, Any]] = []
        task.report(JobState.RENDERING, {"devices": ["fake-0"]})
        while len(curve) < self.STEPS:
            if task.control.reason is not None:
                return Outcome()
            if not self._allowed.acquire(timeout=0.02):
                continue
            curve.append(error_at(len(curve) + 1))
            (task.folder / THUMBNAIL).write_bytes(png(160, 120, len(curve)))
            (task.folder / HEATMAP).write_bytes(png(160, 120, 10 - len(curve)))
            task.report(JobState.RENDERING, self._news(curve))
            task.show()
        if self.fail:
            return Outcome(
                problem=make_problem("kernel", "The kernel does not build", 500, "line 7: no such word")
            )
        (task.folder / RESULT).write_bytes(b"exr")
        (task.folder / RECEIPT).write_text(receipt_of(task, self.STEPS))
        return Outcome(StopReason.RELATIVE_ERROR)

    def _news(self, curve: list[dict[str, Any]]) -> dict[str, Any]:
        last = curve[-1]
        return {
            **{key: value for key, value in last.items() if key != "samples"},
            "samples_done": last["samples"],
            "progress": len(curve) / self.STEPS,
            "theta": 1.0,
            "predicted_seconds": 20.0 - last["seconds"],
            "curve": list(curve),
        }


class Served:
    """A running service, where it is, and its runner."""

    def __init__(self, data: Path) -> None:
        self.runner = SteppingRunner()
        settings = Settings(data=data, port=0, heartbeat_seconds=1.0, shutdown_seconds=5.0)
        self._app = create_app(settings, self.runner)
        config = uvicorn.Config(
            self._app, host="127.0.0.1", port=0, log_level="warning", timeout_graceful_shutdown=1
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        deadline = time.monotonic() + 20
        while not self._server.started:
            assert time.monotonic() < deadline, "the service did not start"
            time.sleep(0.01)
        port = self._server.servers[0].sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{port}"

    @property
    def service(self) -> RenderService:
        service: RenderService = self._app.state.service
        return service

    def stop(self) -> None:
        self._server.should_exit = True
        self._thread.join(20)


@pytest.fixture
def scene() -> dict[str, Any]:
    """A scene that the test may change."""
    return {**SCENE}


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    """A service of its own for each test."""
    served = Served(tmp_path / "data")
    yield served
    served.stop()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Debian's chromium. Its tests are skipped by name without it, unless tools are demanded.

    Ended with the module: Playwright's event loop would keep later tests from running one of their own.
    """
    if CHROMIUM is None:
        if os.environ.get("PENUMBRA_REQUIRE_TOOLS") == "1":
            pytest.fail("chromium is missing: apt-get install chromium")
        pytest.skip("needs chromium (apt-get install chromium)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A tab. Any error in a script, and anything that the content security policy refuses, fails the test."""
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    page = context.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda said: complaints.append(said.text) if "Content Security" in said.text else None)
    page.set_default_timeout(10_000)
    yield page
    context.close()
    assert not complaints
