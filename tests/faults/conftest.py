"""Farms of separate processes on loopback: a scheduler, workers on fake devices or on PoCL, services, and an engine here."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import OpenImageIO
import pytest
from penumbra_scene.job import JobState, Progress
from penumbra_scene.scene import Scene
from penumbra_service.engine.dask.engine import DaskEngine
from penumbra_service.engine.launch import DEVICE_COMMAND
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.runner import JobRunner, RenderTask, RunResult

ROOT = Path(__file__).parents[2]
FAKE = Path(__file__).parents[1] / "service" / "engine" / "fake_device.py"
FAKE_COMMAND = (sys.executable, str(FAKE))
POCL = "pocl:0"
PATIENCE = 400.0
"""Seconds for anything that a busy machine takes its time for."""
_SCHEDULER = """
import sys
from penumbra_service.engine.dask.scheduler import SchedulerOptions, serve_scheduler
serve_scheduler(SchedulerOptions(port=int(sys.argv[1]), status_port=0))
"""
_WORKER = """
import json
import os
import sys
from pathlib import Path
from penumbra_service.engine.dask import supervisor
from penumbra_service.engine.dask.supervisor import WorkerOptions, supervise
supervisor.WAITS = (0.5, 1.0)  # who is killed every few seconds would soon be left alone for half a minute
scheduler, name, cache, device = sys.argv[1:5]
selftest = tuple(json.loads(os.environ.get("SELFTEST", "[]")))
command = tuple(sys.argv[5:])
supervise(WorkerOptions(scheduler, None, (device,), name, cache=Path(cache), device_command=command, selftest=selftest))
"""


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


@pytest.fixture(name="free_port")
def _a_free_port() -> int:
    return free_port()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """`make faults` runs all; the suite leaves out what takes long."""
    if os.environ.get("PENUMBRA_FAULTS") != "all":
        for item in items:
            if item.get_closest_marker("thorough"):
                item.add_marker(pytest.mark.skip(reason="thorough: make faults"))


class Farm:
    """Starts and ends the processes; `engine` is the service's side. `device`: what workers drive unless told otherwise, by
    the device process `command`, with these `variables` in its environment."""

    def __init__(
        self,
        folder: Path,
        device: str = "fake:0",
        command: tuple[str, ...] = FAKE_COMMAND,
        **variables: str,
    ) -> None:
        self.folder = folder
        self._device = device
        self._command = command
        self._variables = variables
        self.port = free_port()
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self.engine = DaskEngine(self.address, str(folder / "contents"))
        self.start_scheduler()
        self.engine.start()

    def start_scheduler(self) -> None:
        self._start("scheduler", [sys.executable, "-c", _SCHEDULER, str(self.port)])

    def add_worker(self, name: str, command: tuple[str, ...] = (), **variables: str) -> None:
        cache = str(self.folder / f"cache-{name}")
        words = [self.address, name, cache, self._device, *(command or self._command)]
        self._start(name, [sys.executable, "-c", _WORKER, *words], **{**self._variables, **variables})

    def wait_for(self, *names: str) -> None:
        self.wait_until(lambda: set(names) <= self.up(), f"workers {names} have joined")

    def wait_until(self, holds: Callable[[], Any], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, f"waited in vain until {what}"
            time.sleep(0.02)

    def run(
        self, task: RenderTask, disturb: Callable[[], object] | None = None, share: float = 0.3
    ) -> RunResult:
        """The job on this farm; `disturb` is called once, when this share of it is done."""
        left = [disturb] if disturb else []

        def look(state: JobState, progress: Progress) -> None:
            if left and progress.progress >= share:
                threading.Thread(target=left.pop()).start()

        result = JobRunner(self.engine, task, on_progress=look).run()
        assert result.state is JobState.FINISHING, result.failure
        assert not left, "the job was done before it could be disturbed"
        return result

    def up(self) -> set[str]:
        """Names of the workers that have joined and answer."""
        return {device.id.partition("@")[2] for device in self.engine.usable()}

    def worker_pid(self, name: str) -> int:
        """The Dask worker's process, a child of the one that keeps it up."""
        return children(self.processes[name].pid)[0]

    def device_pid(self, name: str) -> int | None:
        """The process that drives a worker's device; None while there is none."""
        with contextlib.suppress(OSError, IndexError):
            pids = children(self.worker_pid(name))
            return next((pid for pid in pids if self.process_runs(pid, "device_process")), None)
        return None

    @staticmethod
    def process_runs(pid: int, what: str) -> bool:
        """Whether the process is there and its command line names this."""
        try:
            return what in Path(f"/proc/{pid}/cmdline").read_text()
        except OSError:
            return False

    def kill(self, name: str) -> None:
        """SIGKILL to the process that was started under this name, and with it to all below it."""
        process = self.processes.pop(name)
        process.kill()
        process.wait()

    def close(self) -> None:
        self.engine.stop()
        for process in self.processes.values():
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
                process.terminate()
        for process in self.processes.values():
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, name: str, command: list[str], **variables: str) -> None:
        log = (self.folder / f"{name}.log").open("a")
        self.processes[name] = subprocess.Popen(
            command, env={**os.environ, **variables}, stdout=log, stderr=log, text=True
        )
        log.close()


def children(pid: int) -> list[int]:
    """Of all threads of a process."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(word) for task in tasks for word in (task / "children").read_text().split()]


@pytest.fixture(scope="session")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Farm]:
    """A scheduler and two workers, one and two."""
    farm = Farm(tmp_path_factory.mktemp("farm"))
    try:
        for name in ("one", "two"):
            farm.add_worker(name)
        yield farm
    finally:
        farm.close()


def _task(parent: Path, name: str, folder: str, **sections: Any) -> RenderTask:
    scene = {
        "version": 1,
        "name": name,
        "camera": {"type": "perspective"},
        "film": {"width": 128, "height": 128},
        "sampler": {"type": "independent"},
        "stop": {"samples": 512},
        **sections,
    }
    return RenderTask(uuid.uuid4().hex, Scene.model_validate(scene), parent / folder)


@pytest.fixture
def make_task(tmp_path: Path) -> Callable[..., RenderTask]:
    """make_task(name, folder, stop={...}): words of `name` say how fake devices behave."""

    def make(name: str = "steady", folder: str = "job", **sections: Any) -> RenderTask:
        return _task(tmp_path, name, folder, **sections)

    return make


def _digests(channels: dict[str, bytes]) -> dict[str, str]:
    """Equal for equal bits, and short: pytest compares what differs line by line, which takes minutes for pictures."""
    return {name: hashlib.blake2b(data, digest_size=16).hexdigest() for name, data in channels.items()}


def _picture(result: RunResult) -> dict[str, str]:
    channels: dict[str, list[bytes]] = {}
    for band in result.bands():
        for name, values in (*band.floats.items(), *band.integers.items()):
            channels.setdefault(name, []).append(values.tobytes())
    return _digests({name: b"".join(rows) for name, rows in channels.items()})


@pytest.fixture(scope="session")
def picture() -> Callable[[RunResult], dict[str, str]]:
    """picture(result): a digest of every channel of a finished run, by name."""
    return _picture


@pytest.fixture(scope="session")
def local_run() -> Iterator[Callable[[RenderTask], RunResult]]:
    """local_run(task): on this machine's engine, undisturbed."""
    with LocalEngine(command=(sys.executable, str(FAKE))) as engine:
        yield lambda task: JobRunner(engine, task).run()


@pytest.fixture(scope="session")
def undisturbed(local_run: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the job of make_task("steady") gives on this machine alone."""
    return _picture(local_run(_task(tmp_path_factory.mktemp("undisturbed"), "plain", "job")))


class Service:
    """`python -m penumbra_service` on a farm, or with no scheduler on this machine's devices."""

    def __init__(self, folder: Path, scheduler: str = "", database: str = "", **variables: str) -> None:
        self._environment = {
            **os.environ,
            "PENUMBRA_DATA": str(folder),
            "PENUMBRA_PORT": "0",
            "PENUMBRA_SCHEDULER": scheduler,
            "PENUMBRA_DATABASE_URL": database,
            **variables,
        }
        self.log = folder.with_name(f"{folder.name}.log")
        self.process: subprocess.Popen[str] | None = None
        self._url = ""

    def start(self) -> None:
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "penumbra_service"],
                env=self._environment,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        assert self.process.stdout is not None
        for line in self.process.stdout:
            found = re.search(r"listens on (\S+)", line)
            if found:
                self._url = found.group(1)
                return
        raise AssertionError("the service did not start")

    def kill(self) -> None:
        assert self.process is not None
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            self.process.wait(60)

    def get(self, path: str) -> httpx.Response:
        answer = httpx.get(self._url + path, timeout=60)
        answer.raise_for_status()
        return answer

    def post(self, path: str) -> None:
        """A POST without a body, which must be taken."""
        httpx.post(self._url + path, timeout=30).raise_for_status()

    def submit(self, document: dict[str, Any]) -> str:
        answer = httpx.post(self._url + "/v1/jobs", json=document, timeout=60)
        answer.raise_for_status()
        return str(answer.json()["id"])

    def wait(self, job: str, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while True:
            status = self.status(job)
            if status is not None and holds(status):
                return status
            if status is not None:
                assert status["state"] not in ("failed", "cancelled"), status["problem"]
            assert time.monotonic() < end, self.log.read_text()[-5000:]
            time.sleep(0.1)

    def status(self, job: str) -> dict[str, Any] | None:
        """None where the request meets the very fault that a test has made."""
        answer = httpx.get(f"{self._url}/v1/jobs/{job}", timeout=60)
        found: dict[str, Any] = answer.json()
        return found if answer.status_code == 200 else None

    def done(self, job: str) -> None:
        """Waits until a job is."""
        self.wait(job, lambda status: status["state"] == "done")

    def receipts(self, job: str, frames: tuple[int, ...] = ()) -> list[dict[str, Any]]:
        """Of a job, or of each of its frames."""
        return [self.get(f"/v1/jobs/{job}/{name}").json() for name in _files("receipt.json", frames)]

    def channels(self, job: str, frames: tuple[int, ...] = ()) -> dict[str, str]:
        """A digest of every channel of every EXR of a job, by file and name."""
        found = {}
        for name in _files("result.exr", frames):
            with tempfile.TemporaryDirectory() as folder:
                digests = _channels(self.get(f"/v1/jobs/{job}/{name}").content, Path(folder))
            found |= {f"{name} {channel}": digest for channel, digest in digests.items()}
        return found


def _files(name: str, frames: tuple[int, ...]) -> list[str]:
    return [f"frames/{frame}/{name}" for frame in frames] or [name]


@pytest.fixture
def service(farm: Any, tmp_path: Path) -> Iterator[Service]:
    service = Service(tmp_path / "data", farm.address)
    yield service
    service.stop()


def _channels(data: bytes, folder: Path) -> dict[str, str]:
    path = folder / "result.exr"
    path.write_bytes(data)
    channels = {}
    file = OpenImageIO.ImageInput.open(str(path))
    part = 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, OpenImageIO.UNKNOWN)
        channels |= {name: pixels[..., i].tobytes() for i, name in enumerate(spec.channelnames)}
        part += 1
    file.close()
    return _digests(channels)


@pytest.fixture(scope="session")
def channels() -> Callable[[bytes, Path], dict[str, str]]:
    """channels(exr, folder): a digest of every channel of an EXR file's bytes, by name; `folder` is written to."""
    return _channels


# PoCL: real devices. Cornell's box in three kinds of jobs.


@pytest.fixture(scope="session")
def jobs() -> dict[str, tuple[dict[str, Any], tuple[int, ...]]]:
    """Kinds of jobs: what is submitted, and the frames that it has."""
    scene = json.loads((ROOT / "examples" / "cornell.json").read_text())
    scene |= {"film": {"width": 128, "height": 128}, "stop": {"samples": 512}}
    turning = [{"time": 0.0, "transform": []}, {"time": 1.0, "transform": [{"translate": [0.5, 0, 0]}]}]
    moving = json.loads(json.dumps(scene))
    moving["shapes"][-1]["transform"] = {"keyframes": turning}
    moving["stop"] = {"samples": 128}
    adaptive = {**scene, "adaptive": {"strategy": "error", "mode": "certified"}}
    return {
        "still": (scene, ()),
        "adaptive": (adaptive, ()),
        "frames": ({"scene": moving, "frames": "0-8x4", "fps": 8}, (0, 4, 8)),
    }


@pytest.fixture(scope="session")
def pocl_farm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Farm]:
    """A scheduler and two workers, one and two, each of which has PoCL on one thread."""
    farm = Farm(tmp_path_factory.mktemp("pocl"), POCL, DEVICE_COMMAND, POCL_MAX_PTHREAD_COUNT="1")
    try:
        for name in ("one", "two"):
            farm.add_worker(name)
        yield farm
    finally:
        farm.close()


@pytest.fixture(scope="session")
def pocl_undisturbed(jobs: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """The channels of every kind of job, from a service on this machine's device."""
    folder = tmp_path_factory.mktemp("local") / "data"
    service = Service(folder, PENUMBRA_DEVICES=POCL, POCL_MAX_PTHREAD_COUNT="2")
    found = {}
    try:
        service.start()
        for kind, (document, frames) in jobs.items():
            job = service.submit(document)
            service.done(job)
            found[kind] = service.channels(job, frames)
    finally:
        service.stop()
    return found


@pytest.fixture
def pocl_service(pocl_farm: Any, tmp_path: Path) -> Iterator[Service]:
    service = Service(tmp_path / "data", pocl_farm.address)
    try:
        service.start()
        yield service
    finally:
        service.stop()


@pytest.fixture(scope="session")
def make_service() -> type[Service]:
    """make_service(folder, scheduler, database, **variables)"""
    return Service
