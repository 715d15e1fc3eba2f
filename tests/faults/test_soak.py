"""Jobs one after the other on a farm whose workers, scheduler and service are killed at random; nothing is lost.

PENUMBRA_SOAK_KILLS says how often; `make soak` takes 200. Without it the test is left out.
"""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import pytest

KILLS = int(os.environ.get("PENUMBRA_SOAK_KILLS", "0"))
SECONDS_A_KILL = 15.0
"""Bound on the whole: many times what it takes."""


@pytest.mark.skipif(KILLS == 0, reason="PENUMBRA_SOAK_KILLS is not set: make soak")
@pytest.mark.timeout(120 + KILLS * SECONDS_A_KILL)
def test_random_kills_lose_nothing(farm, service, channels, make_task, picture, local_run, tmp_path):  # type: ignore[no-untyped-def]
    draw = random.Random(20260801)
    stop = {"samples": 1024}
    expected = picture(local_run(make_task("plain", "local", stop=stop)))
    document = make_task("steady", stop=stop).scene.model_dump(mode="json")
    farm.add_worker("three")
    farm.wait_for("one", "two", "three")
    service.start()
    killed = {"worker": 0, "scheduler": 0, "service": 0}
    jobs: list[str] = []
    while sum(killed.values()) < KILLS:
        if not jobs or service.get(f"/v1/jobs/{jobs[-1]}").json()["state"] == "done":
            jobs.append(service.submit(document))
        time.sleep(draw.uniform(0.1, 1.5))
        victim = draw.choices(list(killed), (18, 1, 1))[0]
        killed[victim] += _kill(victim, farm, service, draw)
    for job in jobs:
        service.wait(job, lambda status: status["state"] == "done")
    receipts = [service.get(f"/v1/jobs/{job}/receipt.json").json() for job in jobs]
    for number, job in enumerate(jobs):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert channels(service.get(f"/v1/jobs/{job}/result.exr").content, folder) == expected
    redone = sum(receipt["redone_leases"] for receipt in receipts)
    print(f"{killed}: {len(jobs)} jobs done, {redone} leases done again")
    assert redone > 0


def _kill(victim: str, farm: Any, service: Any, draw: random.Random) -> int:
    """SIGKILL; how many that were."""
    if victim == "worker":
        found = _worker_pids(farm)
        if not found:
            return 0
        os.kill(draw.choice(found), signal.SIGKILL)
    elif victim == "scheduler":
        farm.kill("scheduler")
        farm.start_scheduler()
    else:
        service.kill()
        service.start()
    return 1


def _worker_pids(farm: Any) -> list[int]:
    """Dask workers that are up just now; what keeps them up is left alone."""
    pids = []
    for name in ("one", "two", "three"):
        parent = farm.processes[name].pid
        words = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
        pids += [int(word) for word in words if farm.process_runs(int(word), "dask.worker")]
    return pids
