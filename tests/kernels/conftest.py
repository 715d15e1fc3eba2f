"""A way to run a small kernel on a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.device import KIND_CPU, Device, devices

Launch = Callable[..., None]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Lanes of sixteen are what CPUs follow paths in; no program of another device holds them, and some drivers take
    minutes to compile them."""
    others = {info.id for info in devices() if info.kind != KIND_CPU}
    for item in items:
        own = getattr(item, "callspec", None)
        if "16.py" in item.nodeid and own is not None and own.params.get("device") in others:
            item.add_marker(pytest.mark.skip(reason="only CPUs follow paths in lanes"))


@pytest.fixture(scope="session")
def compiled(device: Device) -> Callable[[str, Mapping[str, int]], Launch]:
    """compiled(text, flags) -> launch(name, size, out, *arguments).

    Runs kernel `name` over `size` work-items and fills `out` from the buffer that is its first argument.
    Arrays are uploaded; numpy scalars pass by value.
    """

    def build(text: str, flags: Mapping[str, int]) -> Launch:
        kernels = {
            kernel.function_name: kernel for kernel in device.build("test.cl", flags, text).all_kernels()
        }

        def launch(name: str, size: int, out: NDArray[Any], *arguments: Any) -> None:
            result = device.allocate(out.nbytes)
            buffers = [device.upload(a) if isinstance(a, np.ndarray) else a for a in arguments]
            kernels[name](device.queue, (size,), None, result, *buffers)
            device.download(result, out)

        return launch

    return build
