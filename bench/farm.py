"""Measures what a farm costs on this machine, and writes it into docs/farm.md: how much of a job's time its devices hold a
running lease, and core-seconds a sample against the local engine.

python bench/farm.py [--seconds 120] [--pairs 3] [--samples 512] [--no-page]

Two workers, each with PoCL on one thread; the local engine with two such devices, so that devices and leases are alike. A
device holds a running lease from the lease's start to its answer, as its own process sees it; the rest is waiting for the
next. The clock runs from the first scene that is loaded. Core-seconds are the CPU time of all processes that take part
(service, scheduler, workers, devices), over the samples of the picture. Jobs of both engines take turns.

Leases that are computed twice are left out (their share is a setting, and their cost its value): they would count as work of
devices, not of the farm.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from block import processor, table, write_block
from penumbra_scene.job import JobState
from penumbra_scene.scene import Scene
from penumbra_service.engine.dask.engine import DaskEngine
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.runner import JobRunner, RenderTask

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "bench" / "results" / "farm.json"
JOIN_SECONDS = 180.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", type=Path, default=ROOT / "examples" / "cornell.json")
    parser.add_argument("--seconds", type=float, default=120.0, help="of the job whose leases are looked at")
    parser.add_argument("--pairs", type=int, default=3, help="jobs on each engine in turn, for core-seconds")
    parser.add_argument("--samples", type=int, default=512, help="a pixel, of these jobs")
    parser.add_argument("--no-page", action="store_true", help="print the numbers and write nothing")
    options = parser.parse_args()
    # Of all processes below: workers see one device of one thread each, the local engine two.
    os.environ |= {"POCL_MAX_PTHREAD_COUNT": "1", "POCL_DEVICES": "pthread pthread"}
    scene = Scene.model_validate(json.loads(options.scene.read_text()))
    load = os.getloadavg()[0]  # of whatever else this machine is at
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("PENUMBRA_CACHE", folder + "/cache")
        with _farm(Path(folder)) as farm, LocalEngine(["pocl:0", "pocl:1"]) as local:
            local.wait_known(JOIN_SECONDS)
            told = _pairs(farm, local, scene, Path(folder), options)
            told |= _held(farm, scene, Path(folder), options.seconds)
    told |= {"processor": processor(), "scene": options.scene.name, "load_average": load}
    print(json.dumps(told, indent=1))
    if not options.no_page:
        RESULTS.write_text(json.dumps(told, indent=1) + "\n")
        write_block("farm", page(told))


@contextlib.contextmanager
def _farm(folder: Path) -> Iterator[DaskEngine]:
    """A scheduler and two workers on loopback."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    penumbra = [sys.executable, "-m", "penumbra_client"]
    commands = [[*penumbra, "scheduler", "--port", str(port), "--status-port", "0"]]
    for number, name in enumerate(("one", "two")):
        more = ["--scheduler", address, "--name", name, "--cache", str(folder / name)]
        commands.append([*penumbra, "worker", *more, "--devices", f"pocl:{number}"])
    processes = [subprocess.Popen(c, stdout=subprocess.DEVNULL) for c in commands]
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
    """Core-seconds a million samples on both engines, in turn, by who spent them."""
    engines: tuple[tuple[str, Engine], ...] = (("local", local), ("farm", farm))
    for name, engine in engines:
        _run(engine, scene, folder / f"warm-{name}", {"samples": 16})
    spent: dict[str, list[dict[str, float]]] = {"local": [], "farm": []}
    for number in range(options.pairs):
        for name, engine in engines:
            before = _cpu_seconds()
            result = _run(engine, scene, folder / f"{name}-{number}", {"samples": options.samples})
            after = _cpu_seconds()
            million = result.record.counts.taken / 1e6
            took = {who: (after[who] - before[who]) / million for who in ENGINES[name]}
            spent[name].append(took | {"all": sum(took.values())})
    ratios = [a["all"] / b["all"] for a, b in zip(spent["farm"], spent["local"], strict=True)]
    # What drives no device, over what does: neighbours of this machine disturb it less than the devices' own time.
    beside = {name: statistics.median(_beside(one) for one in runs) for name, runs in spent.items()}
    return {
        "samples_a_pixel": options.samples,
        "core_seconds_per_million_samples": {
            name: {who: statistics.median(run[who] for run in runs) for who in runs[0]}
            for name, runs in spent.items()
        },
        "farm_over_local": statistics.median(ratios),
        "farm_over_local_runs": ratios,
        "beside_devices": beside,
        "farm_over_local_at_equal_devices": (1 + beside["farm"]) / (1 + beside["local"]),
    }


def _beside(run: dict[str, float]) -> float:
    devices = sum(seconds for who, seconds in run.items() if who.endswith("devices"))
    return (run["all"] - devices) / devices


def _held(farm: DaskEngine, scene: Scene, folder: Path, seconds: float) -> dict[str, Any]:
    """The share of a long job in which its devices hold a running lease."""
    result = _run(farm, scene, folder / "held", {"seconds": seconds})
    elapsed = result.record.seconds
    shares = {use.id: use.seconds / elapsed for use in result.record.devices.values()}
    leases = sum(use.leases for use in result.record.devices.values())
    return {"seconds": elapsed, "leases": leases, "share_of_time_with_a_running_lease": shares}


ENGINES = {
    "local": ("service", "local devices"),
    "farm": ("service", "scheduler", "workers", "farm devices"),
}
"""Whose time counts."""


def _cpu_seconds() -> dict[str, float]:
    """Of this process, which is the service, and of all that descend from it, by what they are."""
    ticks = os.sysconf("SC_CLK_TCK")
    spent = dict.fromkeys({who for names in ENGINES.values() for who in names}, 0.0)
    waiting = [(os.getpid(), "service")]
    while waiting:
        pid, who = waiting.pop()
        folder = Path(f"/proc/{pid}")
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            words = (folder / "cmdline").read_text().split("\0")
            children = [
                int(c) for t in (folder / "task").iterdir() for c in (t / "children").read_text().split()
            ]
        except OSError:
            continue
        if "scheduler" in words:
            who = "scheduler"
        elif any(word.endswith("device_process") for word in words):
            who = "local devices" if who == "service" else "farm devices"
        elif "worker" in words:
            who = "workers"
        spent[who] += (int(fields[11]) + int(fields[12])) / ticks
        waiting += [(child, who) for child in children]
    return spent


def page(told: dict[str, Any]) -> str:
    """What docs/farm.md says of it."""
    costs = told["core_seconds_per_million_samples"]
    names = sorted({who for one in costs.values() for who in one} - {"all"})
    rows = [(who, *(_cell(costs[name].get(who)) for name in costs)) for who in [*names, "all"]]
    shares = " and ".join(f"{share:.1%}" for share in told["share_of_time_with_a_running_lease"].values())
    runs = ", ".join(f"{ratio:.3f}" for ratio in told["farm_over_local_runs"])
    return f"""On {told["processor"]}, `{told["scene"]}`, two devices of one thread each; load average of the machine
before: {told["load_average"]:.1f}.

Two workers held a running lease for {shares} of a job of {told["seconds"]:.0f} s ({told["leases"]} leases).

Core-seconds a million samples at {told["samples_a_pixel"]} samples a pixel, by who spent them (medians of jobs in turn):

{table(("", *costs), rows)}

All of it, farm over local: {told["farm_over_local"]:.3f} ({runs} run by run). With the devices' own time taken as equal, which
is what a machine with other work to do measures best: {told["farm_over_local_at_equal_devices"]:.3f}."""


def _cell(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.4f}"


if __name__ == "__main__":
    main()
