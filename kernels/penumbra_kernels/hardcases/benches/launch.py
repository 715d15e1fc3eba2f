"""Small kernels on a device: one work-item a row."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.device import Device


class Kernels:
    """kernels(name, count, out, *arguments): runs kernel `name` over `count` work-items and fills `out` from the buffer that
    is its first argument. Arrays are uploaded; numpy scalars pass by value."""

    def __init__(self, device: Device, entry: str, text: str, flags: Mapping[str, int] | None = None) -> None:
        self.device = device
        program = device.build(entry, flags or {}, text)
        self._kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}

    def __call__(self, name: str, count: int, out: NDArray[Any], *arguments: Any) -> None:
        result = self.device.allocate(out.nbytes)
        buffers = [self.device.upload(a) if isinstance(a, np.ndarray) else a for a in arguments]
        self._kernels[name](self.device.queue, (count,), None, result, *buffers)
        self.device.download(result, out)
