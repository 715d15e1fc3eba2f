"""Jobs one after the other on a farm of PoCL workers whose processes are killed at random; nothing is lost.

PENUMBRA_SOAK_KILLS says how often; `make soak` takes 200. Without it the test is left out.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from collections import Counter
from typing import Any

import pytest

KILLS = int(os.environ.get("PENUMBRA_SOAK_KILLS", "0"))
SECONDS_A_KILL = 15.0
"""Bound on the whole: many times what it takes."""
GAP = (0.3, 3.0)
"""Seconds between two kills: at random, evenly."""
WORKERS = ("one", "two", "three")
VICTIMS = {"worker": 24, "device": 4, "scheduler": 3, "service": 1, "database": 4}
"""How often each is meant, in parts."""
DEVICES_A_JOB = 2
"""Device processes that may die under one job: a job that more die under in a row is itself to blame."""


@pytest.mark.skipif(KILLS == 0, reason="PENUMBRA_SOAK_KILLS is not set: make soak")
@pytest.mark.timeout(120 + KILLS * SECONDS_A_KILL)
def test_random_kills_lose_nothing(  # type: ignore[no-untyped-def]
    pocl_farm, pocl_undisturbed, jobs, make_service, postgres_url, drop_connections, tmp_path
):
    service = make_service(tmp_path / "data", pocl_farm.address, postgres_url)
    kill = Killer(pocl_farm, service, lambda: drop_connections(postgres_url), random.Random(20260801))
    pocl_farm.add_worker("three")
    pocl_farm.wait_for(*WORKERS)
    began = time.monotonic()
    try:
        service.start()
        given = _storm(pocl_farm, service, jobs, kill)
        took = time.monotonic() - began
        receipts = []
        for kind, job in given:
            frames = jobs[kind][1]
            assert service.channels(job, frames) == pocl_undisturbed[kind], (kind, job)
            receipts += service.receipts(job, frames)
    finally:
        service.stop()
        pocl_farm.kill("three")
    told = {name: sum(r[name] for r in receipts) for name in ("redone_leases", "resumed")}
    print(
        f"\n{kill.done.total()} kills in {took:.0f} s: {dict(kill.done)}; {len(given)} jobs, all done: {told}"
    )
    assert told["redone_leases"] > 0


def _storm(farm: Any, service: Any, jobs: Any, kill: Killer) -> list[tuple[str, str]]:
    """Jobs one after the other until all kills are done and all jobs: their kinds and ids."""
    given: list[tuple[str, str]] = []
    while kill.done.total() < KILLS:
        if not given or _is_done(service, given[-1][1]):
            kind = list(jobs)[len(given) % len(jobs)]
            given.append((kind, _submit(service, jobs[kind][0])))
            kill.devices_left = DEVICES_A_JOB
        time.sleep(kill.draw.uniform(*GAP))
        farm.wait_until(lambda: len(farm.up()) >= 2, "two workers are up, so that something is done at all")
        kill.one()
    for _, job in given:
        service.done(job)
    return given


class Killer:
    """Ends processes at random. `drop` cuts the database's connections."""

    def __init__(self, farm: Any, service: Any, drop: Any, draw: random.Random) -> None:
        self.done: Counter[str] = Counter()
        self.devices_left = 0
        self._farm = farm
        self._served = service
        self._drop = drop
        self.draw = draw

    def one(self) -> None:
        """SIGKILL to one, if it is up just now."""
        victim = self.draw.choices(list(VICTIMS), list(VICTIMS.values()))[0]
        self.done[victim] += getattr(self, f"_{victim}")()

    def _worker(self) -> int:
        """A Dask worker; what keeps it up is left alone."""
        with contextlib.suppress(IndexError):  # none is up
            return _kill(self._farm.worker_pid(self.draw.choice(WORKERS)))
        return 0

    def _device(self) -> int:
        pid = self._farm.device_pid(self.draw.choice(WORKERS))
        if pid is None or self.devices_left == 0:
            return 0
        self.devices_left -= 1
        return _kill(pid)

    def _scheduler(self) -> int:
        self._farm.kill("scheduler")
        self._farm.start_scheduler()
        return 1

    def _service(self) -> int:
        self._served.kill()
        self._served.start()
        return 1

    def _database(self) -> int:
        return int(self._drop() > 0)


def _kill(pid: int) -> int:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
        return 1
    return 0


def _is_done(service: Any, job: str) -> bool:
    status = service.status(job)
    assert status is None or status["state"] not in ("failed", "cancelled"), status["problem"]
    return status is not None and status["state"] == "done"


def _submit(service: Any, document: dict[str, Any]) -> str:
    """The first request may meet a connection to the database that was just cut."""
    with contextlib.suppress(Exception):
        return str(service.submit(document))
    return str(service.submit(document))
