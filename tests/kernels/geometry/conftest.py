"""The geometry bench of the hard cases, for this folder's tests."""

from __future__ import annotations

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches import geometry
from penumbra_kernels.hardcases.benches.geometry import Probe


@pytest.fixture(scope="session")
def kit() -> object:
    """What the tests of this folder use."""
    return geometry


@pytest.fixture(scope="session")
def probe(device: Device) -> Probe:
    """The program with every effect, on each device."""
    return Probe(device)
