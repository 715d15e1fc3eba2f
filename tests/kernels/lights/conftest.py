"""The light bench of the hard cases, for this folder's tests."""

from __future__ import annotations

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.lights import LightBench


@pytest.fixture(scope="session")
def bench(device: Device) -> LightBench:
    """The program with everything in, sampling by solid angle."""
    return LightBench(device)


@pytest.fixture(scope="session")
def area_bench(device: Device) -> LightBench:
    """The same, sampling by area."""
    return LightBench(device, {"PENUMBRA_LIGHT_AREA_SAMPLING": 1})
