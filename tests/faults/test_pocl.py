"""Faults of a farm on PoCL, each with a service in a process of its own: every channel of every EXR has the bits of the
undisturbed one, and the receipt tells what was done again."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

pytestmark = [pytest.mark.thorough, pytest.mark.timeout(1200)]

BROKEN = (sys.executable, str(Path(__file__).with_name("broken_device.py")))
KINDS = ("still", "adaptive", "frames")


@pytest.fixture(autouse=True)
def _two_workers(pocl_farm):  # type: ignore[no-untyped-def]
    for name in ("one", "two"):
        if name not in pocl_farm.processes:
            pocl_farm.add_worker(name)
    pocl_farm.wait_until(lambda: pocl_farm.up() == {"one", "two"}, "one and two are there, and nobody else")


@pytest.fixture
def render(pocl_service, jobs, pocl_undisturbed):  # type: ignore[no-untyped-def]
    """render(disturb, kind='still', share=0.3): the receipts of a job that was disturbed when that share of it was done, after
    its pictures were compared."""

    def run(disturb, kind="still", share=0.3, service=pocl_service):  # type: ignore[no-untyped-def]
        document, frames = jobs[kind]
        job = service.submit(document)
        service.wait(job, lambda status: status["progress"] >= share)
        assert service.status(job)["state"] != "done", "the job was done before it could be disturbed"
        disturb()
        service.done(job)
        assert service.channels(job, frames) == pocl_undisturbed[kind]
        return service.receipts(job, frames)

    return run


def _redone(receipts) -> int:  # type: ignore[no-untyped-def]
    return sum(receipt["redone_leases"] for receipt in receipts)


def _failures(receipts) -> int:  # type: ignore[no-untyped-def]
    return sum(use["failures"] for receipt in receipts for use in receipt["devices"])


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_worker_costs_two_leases(pocl_farm, render, kind):  # type: ignore[no-untyped-def]
    pid = pocl_farm.worker_pid("one")
    receipts = render(lambda: os.kill(pid, signal.SIGKILL), kind)
    assert 1 <= _redone(receipts) <= 2
    assert _failures(receipts) == 0


def test_a_stopped_worker_costs_two_leases(pocl_farm, render):  # type: ignore[no-untyped-def]
    pid, device = pocl_farm.worker_pid("two"), pocl_farm.device_pid("two")

    def stop() -> None:
        for one in (pid, device):
            os.kill(one, signal.SIGSTOP)

    try:
        assert 1 <= _redone(render(stop)) <= 2
    finally:
        for one in (device, pid):
            os.kill(one, signal.SIGCONT)
    pocl_farm.wait_for("two")


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_scheduler_costs_the_leases_in_flight(pocl_farm, render, kind):  # type: ignore[no-untyped-def]
    def disturb() -> None:
        pocl_farm.kill("scheduler")
        pocl_farm.start_scheduler()

    assert 1 <= _redone(render(disturb, kind)) <= 4


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_service_goes_on_from_its_snapshot(pocl_service, render, tmp_path, kind):  # type: ignore[no-untyped-def]
    def snapshots() -> list[Path]:
        return list((tmp_path / "data" / "work").rglob("*.tile"))

    def disturb() -> None:
        (job,) = pocl_service.get("/v1/jobs").json()["items"]
        # A pause writes a snapshot: jobs of seconds are done before their first one is due.
        pocl_service.post(f"/v1/jobs/{job['id']}/pause")
        end = time.monotonic() + 60
        while not snapshots():
            assert time.monotonic() < end, "no snapshot was written"
            time.sleep(0.02)
        pocl_service.post(f"/v1/jobs/{job['id']}/resume")
        pocl_service.wait(job["id"], lambda status: status["state"] in ("compiling", "rendering"))
        pocl_service.kill()
        pocl_service.start()

    assert sum(receipt["resumed"] for receipt in render(disturb, kind)) >= 1


def test_dropped_connections_to_the_database_cost_nothing(  # type: ignore[no-untyped-def]
    pocl_farm, render, make_service, postgres_url, drop_connections, tmp_path
):
    service = make_service(tmp_path / "served", pocl_farm.address, postgres_url)
    service.start()
    dropped: list[int] = []

    def disturb() -> None:
        for _ in range(5):
            dropped.append(drop_connections(postgres_url))
            time.sleep(0.3)

    try:
        receipts = render(disturb, service=service)
    finally:
        service.stop()
    assert sum(dropped) > 0
    assert _redone(receipts) == 0


def test_a_worker_that_gives_garbage_is_found_out_and_its_work_is_done_again(pocl_farm, render):  # type: ignore[no-untyped-def]
    pocl_farm.add_worker("liar", BROKEN, BROKEN="garbage")
    pocl_farm.wait_for("liar")
    (receipt,) = render(lambda: None, share=0.0)
    pocl_farm.kill("liar")
    blocked = {use["id"]: use["blocked"] for use in receipt["devices"]}
    assert blocked == {"pocl:0@one": None, "pocl:0@two": None, "pocl:0@liar": "wrong"}
    assert "device pocl:0@liar gave other sums than two others" in " ".join(receipt["warnings"])
    assert receipt["redone_leases"] >= 1


def test_a_device_that_refuses_three_times_is_blocked(pocl_farm, render):  # type: ignore[no-untyped-def]
    pocl_farm.add_worker("weak", BROKEN, BROKEN="refuse")
    pocl_farm.wait_for("weak")
    (receipt,) = render(lambda: None, share=0.0)
    pocl_farm.kill("weak")
    weak = next(use for use in receipt["devices"] if use["id"] == "pocl:0@weak")
    assert (weak["leases"], weak["failures"], weak["blocked"]) == (0, 3, "failures")
    assert receipt["redone_leases"] >= 3


def test_a_device_whose_process_dies_three_times_is_blocked(pocl_farm, pocl_service, render):  # type: ignore[no-untyped-def]
    def done() -> int:
        devices = pocl_service.get("/v1/devices").json()["items"]
        return next((d["leases_done"] for d in devices if d["id"] == "pocl:0@two"), 0)

    def left_out() -> bool:
        return "was left out after 3 failures" in pocl_service.log.read_text()

    def disturb() -> None:
        other = pocl_farm.device_pid("one")
        os.kill(other, signal.SIGSTOP)  # the job shall not be done before the third
        try:
            while not left_out():
                before = done()
                # After a lease it is at the next one, which lies there already: the death is its failure.
                pocl_farm.wait_until(lambda least=before: done() > least or left_out(), "a lease is done")
                with contextlib.suppress(TypeError, ProcessLookupError):
                    os.kill(pocl_farm.device_pid("two"), signal.SIGKILL)
                time.sleep(0.5)
        finally:
            os.kill(other, signal.SIGCONT)

    (receipt,) = render(disturb, share=0.05)
    killed = next(use for use in receipt["devices"] if use["id"] == "pocl:0@two")
    assert (killed["failures"], killed["blocked"]) == (3, "failures")
    assert "was ended by SIGKILL" in " ".join(receipt["warnings"])


def test_a_worker_that_joins_late_gets_work(pocl_farm, render):  # type: ignore[no-untyped-def]
    pocl_farm.kill("two")
    pocl_farm.wait_until(lambda: "two" not in pocl_farm.up(), "the worker has left")

    def disturb() -> None:
        other = pocl_farm.device_pid("one")
        os.kill(other, signal.SIGSTOP)  # the job shall not be done before the other is there
        try:
            pocl_farm.add_worker("late")
            pocl_farm.wait_for("late")
        finally:
            os.kill(other, signal.SIGCONT)

    (receipt,) = render(disturb, share=0.02)
    pocl_farm.kill("late")
    late = next(use for use in receipt["devices"] if use["id"] == "pocl:0@late")
    assert late["leases"] > 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.02, 0.3])
def test_a_full_disk_is_waited_for(pocl_farm, render, make_service, mount_disk, kind, share):  # type: ignore[no-untyped-def]
    """It holds all that the service has: database, snapshots, results."""
    small_disk = mount_disk(64 << 20)
    service = make_service(small_disk / "data", pocl_farm.address)
    service.log = small_disk.with_name("small.log")
    service.start()
    ballast = small_disk / "ballast"

    def disturb() -> None:
        with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(1 << 16))
        threading.Timer(12.0, ballast.unlink).start()

    try:
        render(disturb, kind, share, service=service)
    finally:
        service.stop()
    words = service.log.read_text()
    assert "No space left on device" in words or "disk is full" in words


def test_devices_of_unlike_speed_share_a_job_and_check_each_other(  # type: ignore[no-untyped-def]
    pocl_farm, render, make_service, tmp_path
):
    """PoCL with one and with two threads is of one bit class: their leases are compared bit for bit."""
    pocl_farm.kill("two")
    pocl_farm.add_worker("wide", POCL_MAX_PTHREAD_COUNT="2")
    pocl_farm.wait_until(lambda: pocl_farm.up() == {"one", "wide"}, "one and wide are there")
    service = make_service(tmp_path / "served", pocl_farm.address, PENUMBRA_VERIFY_SHARE="0.5")
    service.start()
    try:
        (receipt,) = render(lambda: None, share=0.0, service=service)
        units = {
            device["id"]: device["compute_units"] for device in service.get("/v1/devices").json()["items"]
        }
    finally:
        service.stop()
        pocl_farm.kill("wide")
    assert units == {"pocl:0@one": 1, "pocl:0@wide": 2}
    assert all(use["leases"] > 0 and use["blocked"] is None for use in receipt["devices"])
    assert len({use["bit_class"] for use in receipt["devices"]}) == 1
    assert receipt["bit_class"] != "mixed"
    assert receipt["checked_leases"] >= 3


_SELFTEST = """
import sys
import numpy as np
from runpy import run_module
from penumbra_kernels.tracer import Tracer
trace = Tracer.trace
def dim(*words):
    node = trace(*words)
    node.sums["rgba"][..., :3] *= np.float32(0.95)
    return node
if sys.argv.pop(1) == "dim":
    Tracer.trace = dim
run_module("penumbra_kernels.hardcases", run_name="__main__", alter_sys=True)
"""


def test_a_device_that_fails_the_self_test_does_not_join(pocl_farm):  # type: ignore[no-untyped-def]
    """The self-test's furnace on PoCL: as it is, and where every sum is 5 % too small."""
    for name in ("sound", "dim"):
        selftest = (sys.executable, "-c", _SELFTEST, name, "--case", "white-furnace")
        pocl_farm.add_worker(name, SELFTEST=json.dumps(selftest))
    pocl_farm.wait_for("sound")
    assert pocl_farm.processes.pop("dim").wait(120) != 0
    log = (pocl_farm.folder / "dim.log").read_text()
    pocl_farm.kill("sound")
    assert "device pocl:0 does not join: its self-test failed" in log
    assert "white-furnace                failed" in log
    assert "no device of this machine has passed the self-test" in log
