"""A service whose runner renders nothing: it writes small files, when a test lets it."""

from __future__ import annotations

import copy
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_scene.errors import ProblemError, make_problem
from penumbra_scene.job import DeviceState, DeviceStatus, JobRequest, JobState, StopReason
from penumbra_scene.quote import Quote
from penumbra_service.api.openapi import QUOTE_ANSWER
from penumbra_service.app import create_app
from penumbra_service.results import HEATMAP, RECEIPT, RESULT, THUMBNAIL
from penumbra_service.running import Outcome, Task
from penumbra_service.service import RenderService
from penumbra_service.settings import Settings

ON_POSTGRES = os.environ.get("PENUMBRA_TEST_DATABASE") == "postgresql"

SCENE: dict[str, Any] = {
    "version": 1,
    "name": "a quad",
    "camera": {"type": "perspective"},
    "film": {"width": 32, "height": 24},
    "shapes": [{"type": "quad", "emission": {"radiance": 1}}],
}

QUOTE = Quote.model_validate(QUOTE_ANSWER["content"]["application/json"]["example"])


class FakeRunner:
    """Renders as far as `let(n)` allows: n steps of ten."""

    STEPS = 10

    def __init__(self) -> None:
        self._allowed = threading.Semaphore(0)
        self.ran: list[str] = []
        self.begun_at: list[int] = []
        self.fail = False
        self.raise_error = False
        self.stopped = False
        self.problem: str | None = None

    def let(self, steps: int = STEPS) -> None:
        for _ in range(steps):
            self._allowed.release()

    def start(self) -> None:
        pass

    def stop(self) -> None:
        self.stopped = True

    def quote(self, request: JobRequest, folder: Path) -> Quote:
        if self.fail:
            raise ProblemError(make_problem("job-device", "There is no device to render on", 503, "none"))
        (folder / "scene.json").write_text("{}")
        return QUOTE.model_copy(update={"name": request.scene.name})

    def devices(self) -> list[DeviceStatus]:
        return [DeviceStatus(id="fake-0", name="Fake", platform="None", state=DeviceState.IDLE)]

    def run(self, task: Task) -> Outcome:
        self.ran.append(task.job_id)
        snapshot = task.folder / "snapshot"
        done = int(snapshot.read_text()) if snapshot.is_file() else 0
        self.begun_at.append(done)
        if self.raise_error:
            raise RuntimeError("a mistake")
        task.report(JobState.RENDERING, {"devices": ["fake-0"]})
        while done < self.STEPS:
            if task.control.reason is not None:
                return Outcome()
            if not self._allowed.acquire(timeout=0.02):
                continue
            if task.control.reason is not None:
                self._allowed.release()
                return Outcome()
            done += 1
            snapshot.write_text(str(done))
            (task.folder / THUMBNAIL).write_bytes(b"picture %d" % done)
            (task.folder / HEATMAP).write_bytes(b"map %d" % done)
            task.report(
                JobState.RENDERING,
                {"progress": done / self.STEPS, "samples_done": 4.0 * done},
            )
            task.show()
        if self.fail:
            return Outcome(problem=make_problem("kernel", "The kernel does not build", 500, "line 1: no"))
        (task.folder / RESULT).write_bytes(b"exr" * 1000)
        (task.folder / RECEIPT).write_text('{"schema_version": 1}')
        return Outcome(StopReason.SAMPLES)


@pytest.fixture
def scene() -> dict[str, Any]:
    """A scene that the test may change."""
    return copy.deepcopy(SCENE)


@pytest.fixture
def settings(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    """On SQLite, or where PENUMBRA_TEST_DATABASE says so (`make test-postgres`) on PostgreSQL."""
    url = request.getfixturevalue("postgres_url") if ON_POSTGRES else ""
    return Settings(data=tmp_path / "data", database_url=url, heartbeat_seconds=1.0, shutdown_seconds=5.0)


@pytest.fixture
def alone(settings: Settings) -> None:
    """Skips where other services may use the database: what is young there is left to them."""
    if settings.shared:
        pytest.skip("a service that shares its database waits before it takes what another may hold")


@pytest.fixture
def runner() -> FakeRunner:
    return FakeRunner()


@pytest.fixture
def client(settings: Settings, runner: FakeRunner) -> Iterator[TestClient]:
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1:8484") as client:
        yield client


@pytest.fixture
def service(client: TestClient) -> RenderService:
    return client.app.state.service  # type: ignore[attr-defined, no-any-return]


def until(holds: Callable[[], bool]) -> None:
    """Waits until something holds; fails after ten seconds."""
    deadline = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < deadline, "it never came to hold"
        time.sleep(0.01)


@pytest.fixture(name="until")
def until_fixture() -> Callable[[Callable[[], bool]], None]:
    return until


@pytest.fixture
def wait_for(client: TestClient) -> Callable[[str, str], dict[str, Any]]:
    """Waits until a job is in a state, and returns its status."""

    def wait(job_id: str, state: str) -> dict[str, Any]:
        deadline = time.monotonic() + 10
        while True:
            status: dict[str, Any] = client.get(f"/v1/jobs/{job_id}").json()
            if status["state"] == state:
                return status
            assert time.monotonic() < deadline, f"job is {status['state']}, not {state}"
            time.sleep(0.01)

    return wait
