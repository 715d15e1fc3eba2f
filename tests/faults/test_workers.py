"""Workers come, go, hang and lie; the finished picture has the bits of the undisturbed one, in every channel."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import pytest
from penumbra_service.engine.runner import JobRunner


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


@pytest.mark.thorough
def test_a_worker_that_hangs_is_found_out_and_comes_back(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    pid = farm.worker_pid("two")
    result = farm.run(make_task(), lambda: os.kill(pid, signal.SIGSTOP))
    assert picture(result) == undisturbed
    assert 1 <= result.record.redone_leases <= 2
    assert "two" not in farm.up()
    os.kill(pid, signal.SIGCONT)
    farm.wait_for("two")


@pytest.mark.thorough
def test_a_worker_that_joins_late_gets_work(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    farm.kill("two")
    farm.wait_until(lambda: "two" not in farm.up(), "the worker has left")
    task = make_task("steady", stop={"samples": 2048})
    result = farm.run(task, lambda: farm.add_worker("late"), share=0.05)
    late = [use.leases for use in result.record.devices.values() if use.id == "fake:0@late"]
    farm.kill("late")
    assert late
    assert late[0] > 0


def test_a_worker_that_returns_garbage_is_found_out_and_its_work_is_done_again(  # type: ignore[no-untyped-def]
    farm, make_task, picture, undisturbed
):
    farm.add_worker("liar", FAKE_HABIT="garbage")
    farm.wait_for("liar")
    result = farm.run(make_task())
    farm.kill("liar")
    assert picture(result) == undisturbed
    blocked = {use.id: use.blocked for use in result.record.devices.values()}
    assert blocked == {"fake:0@one": None, "fake:0@two": None, "fake:0@liar": "wrong"}
    assert "device fake:0@liar gave other sums than two others" in " ".join(result.record.warnings)
    assert result.record.checked_leases > 0


@pytest.mark.thorough
def test_two_that_contradict_each_other_fail_the_job_for_want_of_a_third(farm, make_task):  # type: ignore[no-untyped-def]
    farm.add_worker("odd", FAKE_BIT_CLASS="odd|1.0")
    farm.add_worker("liar", FAKE_HABIT="garbage", FAKE_BIT_CLASS="odd|1.0")
    farm.wait_for("odd", "liar")
    for name in ("one", "two"):
        farm.kill(name)
    farm.wait_until(lambda: farm.up() == {"odd", "liar"}, "the others have left")
    failure = JobRunner(farm.engine, make_task()).run().failure
    for name in ("odd", "liar"):
        farm.kill(name)
    assert failure is not None
    assert failure.kind == "device"
    assert "give different sums for the same samples" in failure.message


def test_a_device_that_fails_three_times_is_blocked_for_the_job(farm, make_task, picture, undisturbed):  # type: ignore[no-untyped-def]
    farm.add_worker("weak", FAKE_HABIT="refuse")
    farm.wait_for("weak")
    result = farm.run(make_task())
    farm.kill("weak")
    assert picture(result) == undisturbed
    weak = next(use for use in result.record.devices.values() if use.id == "fake:0@weak")
    assert (weak.leases, weak.failures, weak.blocked) == (0, 3, "failures")
    assert result.record.redone_leases >= 3


@pytest.mark.thorough
@pytest.mark.parametrize("strict", [False, True])
def test_a_strict_job_stays_within_one_bit_class_and_others_say_that_they_are_mixed(farm, make_task, strict):  # type: ignore[no-untyped-def]
    farm.add_worker("odd", FAKE_BIT_CLASS="odd|1.0")
    farm.wait_for("odd")
    result = farm.run(replace(make_task(), strict=strict))
    farm.kill("odd")
    classes = {use.bit_class for use in result.record.devices.values() if use.leases}
    assert (len(classes) == 1) == strict
    assert (result.record.bit_class == "mixed") == (not strict)
