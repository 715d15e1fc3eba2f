"""The planner on a small simulated farm: nothing is lost or done twice but what died, and the farm stays busy."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def simulation() -> ModuleType:
    path = Path(__file__).parents[3] / "bench" / "farm_simulation.py"
    spec = importlib.util.spec_from_file_location("farm_simulation", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["farm_simulation"] = module
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(path.parent)
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def farm(simulation: ModuleType):  # type: ignore[no-untyped-def]
    """20 workers for half an hour, who live for ten minutes on average."""
    patch = pytest.MonkeyPatch()
    patch.setattr(simulation, "URGENT_EVERY", 600.0)
    patch.setattr(simulation, "LIFE_SECONDS", 600.0)
    patch.setattr(simulation, "AWAY_SECONDS", 60.0)
    farm = simulation.Farm(20, 0.5, seed=3)
    farm.run()
    patch.undo()
    return farm


def test_a_jobs_work_is_done_exactly_once(farm) -> None:  # type: ignore[no-untyped-def]
    assert farm.finished
    for job in farm.finished:
        assert job.left == 0  # each answered sample once, for all the deaths
        assert job.planner.idle
        assert job.planner.out_samples == 0


def test_what_died_is_done_again_and_no_more(farm, simulation: ModuleType) -> None:  # type: ignore[no-untyped-def]
    account = farm.account
    assert account.deaths > 20
    # two leases at most are lost with a worker; those that are halved count once for each half
    assert 0 < account.redone <= 4 * account.deaths
    assert account.wasted <= account.deaths * (2 * 1.5 * 1.33 + simulation.LOAD_SECONDS)


def test_the_farm_stays_busy(farm) -> None:  # type: ignore[no-untyped-def]
    account = farm.account
    assert account.traced + account.loaded + account.wasted <= account.alive * 1.0001
    idle = account.alive - account.traced - account.loaded - account.wasted
    assert idle < 0.01 * account.alive


def test_an_urgent_job_begins_within_two_leases_of_anybody(farm, simulation: ModuleType) -> None:  # type: ignore[no-untyped-def]
    urgent = [job for job in farm.finished if job.priority]
    assert urgent
    for job in urgent:
        assert job.first_lease is not None
        assert (
            job.first_lease - job.arrived < 2 * simulation.lease_seconds(20) * 1.33 + simulation.LOAD_SECONDS
        )
        assert job.finished is not None
        # some leases, one scene for each worker, and the time that all together need
        ideal = job.total / farm.capacity
        assert job.finished - job.arrived < 2 * ideal + 3 * simulation.LOAD_SECONDS


def test_leases_grow_with_the_farm_only_where_one_service_could_not_follow(simulation: ModuleType) -> None:
    assert [simulation.lease_seconds(n) for n in (1, 75, 150, 10_000)] == [2.0, 2.0, 3.0, 200.0]
