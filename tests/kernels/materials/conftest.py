"""The material bench of the hard cases, for this folder's tests."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.materials import MaterialBench

_benches: dict[tuple[str, int, int, int], MaterialBench] = {}


@pytest.fixture(scope="session")
def bench_with(device: Device) -> Callable[[int, int, int], MaterialBench]:
    """Benches by their flags (gloss, transmission, textures), each built once."""

    def make(gloss: int, transmission: int, textures: int) -> MaterialBench:
        key = (device.info.id, gloss, transmission, textures)
        if key not in _benches:
            _benches[key] = MaterialBench(device, gloss, transmission, textures)
        return _benches[key]

    return make


@pytest.fixture(scope="session")
def bench(bench_with: Callable[[int, int, int], MaterialBench]) -> MaterialBench:
    """The program with every material."""
    return bench_with(1, 1, 0)
