"""A way to run a small kernel on a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.device import Device

Launch = Callable[..., None]


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
