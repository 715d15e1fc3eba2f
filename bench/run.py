"""Everything in one command, as ratios of one run: `make bench`, or

    python bench/run.py [--full] [--only rays paths ...] [--no-page]

Sections run one after the other, each in processes of their own, pinned to one core (CPU seconds) or to all (seconds).
Results go to bench/results/quick.json (or full.json), the change against what stood there is printed, and docs/performance.md
is written from it with its plots. What --full adds, a mesh of ten million triangles, stays in bench/results/large.json with its
machine and date until it is measured again, and on the page. The quick run takes about four minutes on two cores. A peer that
is not installed is named and left out; `pip install -e '.[bench]'` installs them, and Mitsuba's llvm variant wants Debian's
libllvm19.

Cycles and LuxCore are measured by `make bench-peers`, which is --only peers: bench/results/peers.json is kept in the same way.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from peer import PEERS, versions
from penumbra_kernels import pocl_cache
from penumbra_service.film.replicates import DEFAULT_REPLICATES

HERE = Path(__file__).parent
RESULTS = HERE / "results"
WITH_PEERS = ("rays", "paths", "all_cores", "samplers")
"""Sections whose numbers are partly theirs."""
PACKAGES = ("embreex", "mitsuba")
SCENES = ("cornell", "horizon", "gloss", "lens", "glass", "lights", "mesh", "motion")
IN_PATHS = ("penumbra", "penumbra_1", "mitsuba_scalar/multijitter", "mitsuba_llvm/multijitter")
OTHER_SAMPLERS = ("blue_noise", "jittered", "independent")
"""Beside Sobol's, which the section `paths` measures as it does multijitter."""
LARGE = "10000000"
"""Triangles."""
WORTH_TELLING = 0.05
"""Changes below this share are noise on most machines."""


def child(cores: list[int], script: str, *arguments: str) -> Any:
    """What a script of this folder prints as JSON, run on these cores alone."""
    environment = pocl_cache.own_environment() | {
        "POCL_MAX_PTHREAD_COUNT": str(len(cores)),
        "OMP_NUM_THREADS": str(len(cores)),
    }
    done = subprocess.run(
        [sys.executable, "-W", "ignore", str(HERE / script), *arguments],
        env=environment, preexec_fn=lambda: os.sched_setaffinity(0, cores), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{script} {' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout[done.stdout.index("\n{") + 1 if "\n{" in done.stdout else 0 :])


def sections(full: bool, one: list[int], every: list[int]) -> dict[str, Any]:
    """Name -> call that measures."""
    ladder = ["4", "16", "64", "256"]
    return {
        "rays": lambda: child(one, "rays.py", "--turns", "9" if full else "5"),
        "paths": lambda: child(one, "paths.py", "--scenes", *SCENES, "--samples", *ladder, "--renderers", *IN_PATHS),
        "all_cores": lambda: child(
            every, "paths.py", "--scenes", "cornell", "mesh", "--samples", "16", "64",
            "--renderers", "penumbra", "mitsuba_llvm/multijitter",
        ),
        "samplers": lambda: child(
            one, "paths.py", "--scenes", *SCENES, "--samples", "64",
            "--renderers", *(f"penumbra_1/{s}" for s in OTHER_SAMPLERS), "mitsuba_llvm/independent",
        ),
        "scaling": lambda: child(one, "scaling.py", "--largest", "10000000" if full else "1000000"),
        "start": lambda: child(every, "latency.py", "--runs", "9" if full else "5"),
        "memory": lambda: child(every, "memory.py"),
    }  # fmt: skip


def measure_large(every: list[int]) -> None:
    """What is too long for every run: kept for itself."""
    keep("large", {"memory": child(every, "memory.py", "--triangles", LARGE)})


def measure_peers(one: list[int]) -> None:
    """Penumbra and the renderers that have an environment of their own: kept for themselves as well."""
    arguments = (
        "--scenes",
        *SCENES,
        "--samples",
        "4",
        "16",
        "64",
        "256",
        "--renderers",
        "penumbra_1",
        *PEERS,
    )
    keep("peers", {"peers": versions(), "paths": child(one, "paths.py", *arguments)})


def keep(name: str, found: dict[str, Any]) -> None:
    """Into a file of its own, with machine and date."""
    file = RESULTS / f"{name}.json"
    before = json.loads(file.read_text()) if file.exists() else {}
    found = {"machine": machine(), "date": datetime.now(UTC).date().isoformat(), **found}
    file.write_text(json.dumps(found, indent=1) + "\n")
    print_changes(before, found)


def machine() -> dict[str, Any]:
    """What the numbers depend on."""
    from penumbra_kernels.device import devices

    model = platform.processor()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            model = line.partition(":")[2].strip()
            break
    devices_found = [
        {"name": d.name, "driver": d.driver, "platform": d.platform_version, "instructions": d.target}
        for d in devices()
    ]
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)),
        "devices": devices_found,
        "peers": {peer: _version(peer) for peer in PACKAGES},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Every number by its path."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from leaves(item, f"{path}/{key}" if path else key)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            key = item.get("triangles", item.get("samples", i)) if isinstance(item, dict) else i
            yield from leaves(item, f"{path}/{key}")
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, float(value)


def print_changes(before: dict[str, Any], after: dict[str, Any]) -> None:
    """One line a number that changed by more than noise."""
    old = dict(leaves(before))
    changed = [
        (path, old[path], value)
        for path, value in leaves(after)
        if path in old and old[path] and "/points/" not in path and abs(value / old[path] - 1) > WORTH_TELLING
    ]
    if not old:
        print("no results to compare with")
    for path, a, b in changed:
        print(f"{path:68s} {a:10.4g} -> {b:10.4g}  {100 * (b / a - 1):+6.1f} %")
    print(f"{len(changed)} of {len(old)} numbers changed by more than {100 * WORTH_TELLING:.0f} %")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--full", action="store_true", help="more samples, ten million triangles")
    parser.add_argument("--quick", action="store_true", help="the default")
    parser.add_argument(
        "--only",
        nargs="+",
        default=None,
        help="just these sections (or large, peers); the others stay as they were",
    )
    parser.add_argument("--no-page", action="store_true", help="leave docs/performance.md alone")
    options = parser.parse_args()
    every = sorted(os.sched_getaffinity(0))
    chosen = sections(options.full, every[:1], every)
    file = RESULTS / ("full.json" if options.full else "quick.json")
    before = json.loads(file.read_text()) if file.exists() else {}
    results: dict[str, Any] = {"machine": machine(), "replicates": DEFAULT_REPLICATES}
    if options.only and "paths" not in options.only and "replicates" in before:
        results["replicates"] = before["replicates"]
    if options.only and not set(options.only) & set(WITH_PEERS) and before:
        results["machine"]["peers"] = before["machine"]["peers"]  # their numbers stay as well
    for name, measure in chosen.items():
        if options.only and name not in options.only:
            results |= {name: before[name]} if name in before else {}
            continue
        started = time.perf_counter()
        results[name] = measure()
        print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    missing = [peer for peer, found in results["machine"]["peers"].items() if found == "not installed"]
    if missing:
        print(f"not installed, and left out: {', '.join(missing)}")
    RESULTS.mkdir(exist_ok=True)
    file.write_text(json.dumps(results, indent=1) + "\n")
    print_changes(before, results)
    if "large" in (options.only or ()) or (options.full and not options.only):
        measure_large(every)
    if "peers" in (options.only or ()):
        measure_peers(every[:1])
    if not options.no_page:
        from page import write_page

        write_page(results)


if __name__ == "__main__":
    main()
