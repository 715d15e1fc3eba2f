"""Measures what a farm costs: how much of a job's time its devices hold a running lease, and core-seconds a sample against
the local engine, on this machine.

python bench/farm.py [--seconds 120] [--threads 1] [--pairs 3]

Two workers, each with PoCL on `--threads` threads; the local engine with one device of as many threads as both. A device
holds a running lease from the lease's start to its answer, as its own process sees it; the rest is waiting for the next. The
clock runs from the first scene that is loaded. Core-seconds are the CPU time of all processes that take part (service,
scheduler, workers, devices), over the samples in the picture.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from penumbra_scene.job import JobState
from penumbra_scene.scene import Scene
from penumbra_service.engine.dask.engine import DaskEngine
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.runner import JobRunner, RenderTask

ROOT = Path(__file__).resolve().parents[1]
JOIN_SECONDS = 180.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", type=Path, default=ROOT / "examples" / "cornell.json")
    parser.add_argument(
        "--seconds", type=float, default=120.0, help="of the long job, whose leases are looked at"
    )
    parser.add_argument(
        "--pairs", type=int, default=3, help="short jobs on each engine in turn, for core-seconds"
    )
    parser.add_argument("--pair-samples", type=int, default=128, help="a pixel, of the short jobs")
    parser.add_argument("--threads", type=int, default=1, help="of each PoCL device")
    options = parser.parse_args()
    os.environ["POCL_MAX_PTHREAD_COUNT"] = str(
        2 * options.threads
    )  # the local engine's; workers have their own
    scene = Scene.model_validate(json.loads(options.scene.read_text()))
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("PENUMBRA_CACHE", folder + "/cache")
        with _farm(Path(folder), options.threads) as farm, LocalEngine(["pocl:0"]) as local:
            local.wait_known(JOIN_SECONDS)
            _run(local, scene, Path(folder) / "warm-local", {"samples": 8})
            _run(farm, scene, Path(folder) / "warm-farm", {"samples": 8})
            told = _pairs(farm, local, scene, Path(folder), options)
            told |= _held(farm, scene, Path(folder), options.seconds)
    told |= {"processor": _processor(), "threads": options.threads, "scene": options.scene.name}
    print(json.dumps(told, indent=1))


@contextlib.contextmanager
def _farm(folder: Path, threads: int) -> Iterator[DaskEngine]:
    """A scheduler and two workers on loopback."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    penumbra = [sys.executable, "-m", "penumbra_client"]
    commands = [[*penumbra, "scheduler", "--port", str(port), "--status-port", "0"]]
    for name in ("one", "two"):
        more = ["--scheduler", address, "--name", name, "--cache", str(folder / name), "--devices", "pocl:0"]
        commands.append([*penumbra, "worker", *more])
    environment = {**os.environ, "POCL_MAX_PTHREAD_COUNT": str(threads)}
    processes = [subprocess.Popen(c, stdout=subprocess.DEVNULL, env=environment) for c in commands]
    try:
        with DaskEngine(address, str(folder / "contents")) as engine:
            end = time.monotonic() + JOIN_SECONDS
            while len(engine.usable()) < 2:
                if time.monotonic() > end:
                    raise SystemExit("the workers have not joined")
                time.sleep(0.1)
            yield engine
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            process.wait()


def _run(engine: Engine, scene: Scene, folder: Path, stop: dict[str, float]) -> Any:
    task = RenderTask(
        folder.name, scene.model_copy(update={"stop": type(scene.stop)(**stop)}), folder, verify=0.0
    )
    result = JobRunner(engine, task).run()
    if result.state is not JobState.FINISHING:
        raise SystemExit(str(result.failure))
    return result


def _pairs(
    farm: DaskEngine, local: LocalEngine, scene: Scene, folder: Path, options: argparse.Namespace
) -> dict[str, Any]:
    """CPU seconds on both engines, in turn: of all processes a million samples, and of those that drive no device, as a
    share of those that do, which neighbours of this machine disturb less."""
    spent: dict[str, list[float]] = {"farm": [], "local": []}
    beside: dict[str, list[float]] = {"farm": [], "local": []}
    for number in range(options.pairs):
        for name, engine in (("local", local), ("farm", farm)):
            total, device = _cpu_seconds()
            stop = {"samples": options.pair_samples}
            result = _run(engine, scene, folder / f"{name}-{number}", stop)
            total_then, device_then = _cpu_seconds()
            total, device = total_then - total, device_then - device
            spent[name].append(1e6 * total / result.record.counts.taken)
            beside[name].append((total - device) / device)
    ratio = (1 + min(beside["farm"])) / (1 + min(beside["local"]))
    return {
        "core_seconds_per_million_samples": {k: [round(v, 4) for v in vs] for k, vs in spent.items()},
        "beside_devices": {k: [round(v, 4) for v in vs] for k, vs in beside.items()},
        "farm_over_local_at_equal_devices": round(ratio, 4),
    }


def _held(farm: DaskEngine, scene: Scene, folder: Path, seconds: float) -> dict[str, Any]:
    """The share of a long job in which its devices hold a running lease."""
    result = _run(farm, scene, folder / "held", {"seconds": seconds})
    elapsed = result.record.seconds
    shares = {use.id: round(use.seconds / elapsed, 4) for use in result.record.devices.values()}
    leases = sum(use.leases for use in result.record.devices.values())
    return {"seconds": round(elapsed, 1), "leases": leases, "share_of_time_with_a_running_lease": shares}


def _cpu_seconds() -> tuple[float, float]:
    """Of this process and all that descend from it, and of the device processes among them."""
    ticks = os.sysconf("SC_CLK_TCK")
    total = device = 0.0
    waiting = [os.getpid()]
    while waiting:
        folder = Path(f"/proc/{waiting.pop()}")
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            drives = "device_process" in (folder / "cmdline").read_text()
            for thread in (folder / "task").iterdir():
                waiting += [int(child) for child in (thread / "children").read_text().split()]
        except OSError:
            continue
        seconds = (int(fields[11]) + int(fields[12])) / ticks
        total += seconds
        device += seconds if drives else 0.0
    return total, device


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return f"{line.split(':', 1)[1].strip()}, {os.cpu_count()} cores"
    return platform.processor()


if __name__ == "__main__":
    main()
