"""Workers come, go, hang and lie; the finished picture has the bits of the undisturbed one, in every channel."""

from __future__ import annotations

import os
import signal

import pytest


@pytest.fixture(autouse=True)
def _two_workers(farm):  # type: ignore[no-untyped-def]
    for name in ("one", "two"):
        if name not in farm.processes:
            farm.add_worker(name)
    farm.wait_for("one", "two")


def test_a_farm_gives_the_bits_of_the_local_engine(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    result = farm.run(make_task())
    assert picture(result) == undisturbed
    assert {use.id for use in result.record.devices.values()} == {"fake:0@one", "fake:0@two"}
    assert result.record.redone_leases == 0
    assert result.record.program_hash == "0" * 64
    assert {effect.name for effect in result.record.effects} == {"lens", "gloss"}


def test_a_killed_worker_costs_at_most_two_leases(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    pid = farm.worker_pid("one")
    result = farm.run(make_task(), lambda: os.kill(pid, signal.SIGKILL))
    assert picture(result) == undisturbed
    assert 1 <= result.record.redone_leases <= 2
    assert result.record.crashes == 0
    farm.wait_for("one")  # what keeps it up has started it again
    assert farm.worker_pid("one") != pid


def test_a_worker_that_hangs_is_found_out_and_comes_back(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    pid = farm.worker_pid("two")
    result = farm.run(make_task(), lambda: os.kill(pid, signal.SIGSTOP))
    assert picture(result) == undisturbed
    assert 1 <= result.record.redone_leases <= 2
    assert "two" not in farm.up()
    os.kill(pid, signal.SIGCONT)
    farm.wait_for("two")


def test_a_worker_that_joins_late_gets_work(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    farm.kill("two")
    farm.wait_until(lambda: "two" not in farm.up(), "the worker has left")
    task = make_task("steady", stop={"samples": 2048})
    result = farm.run(task, lambda: farm.add_worker("late"), share=0.05)
    late = [use.leases for use in result.record.devices.values() if use.id == "fake:0@late"]
    farm.kill("late")
    assert late
    assert late[0] > 0
