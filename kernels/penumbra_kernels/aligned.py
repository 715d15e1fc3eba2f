"""Memory that numpy and a CPU's kernels share: kernels load whole vectors from it, so it begins at a multiple of ALIGNMENT."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ALIGNMENT: Final = 64
"""Bytes; numpy's own arrays are aligned to 16."""


def empty(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """(count,) of the dtype, undefined, which a device of the host's memory can take as it is."""
    size = count * dtype.itemsize
    room = np.empty(size + ALIGNMENT, np.uint8)
    first = -room.ctypes.data % ALIGNMENT
    return room[first : first + size].view(dtype)


def aligned(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The bytes where they are aligned; a copy of them otherwise."""
    if data.ctypes.data % ALIGNMENT == 0:
        return data
    out = empty(data.size, data.dtype)
    out[:] = data
    return out
