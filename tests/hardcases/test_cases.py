"""Every hard case on every device, each number within its bound. `make test-hard` runs them with the catalogue's counts."""

from __future__ import annotations

import os
from functools import lru_cache

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases import HardCase, Workbench, cases, run_case

FULL = os.environ.get("PENUMBRA_HARD_CASES", "fast") == "full"


@lru_cache
def _bench(device: Device) -> Workbench:
    """One a device, so that its cases share their programs."""
    return Workbench(device, full=FULL)


@pytest.mark.parametrize("case", cases(), ids=lambda case: f"{case.number}-{case.name}")
def test_hard_case_keeps_its_bounds(device: Device, case: HardCase) -> None:
    outcome = run_case(case, _bench(device))
    beyond = [f"{m.what}: {m.value:g}, bound {m.bound:g}" for m in outcome.measures if not m.passed]
    assert outcome.status == "passed", outcome.message or beyond
