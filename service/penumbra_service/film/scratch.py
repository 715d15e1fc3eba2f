"""Room for the arrays of one tile after the other: fresh memory costs a page fault for every 4 KiB, which together take
longer than the arithmetic of a look at a picture."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Empty = Callable[[tuple[int, ...]], NDArray[np.float64]]
"""Makes an array of a shape, its values not set; numpy.empty is one."""


class Scratch:
    """One buffer, handed out piece by piece. One thread."""

    def __init__(self) -> None:
        self._buffer = np.empty(0)
        self._used = 0

    def reset(self) -> None:
        """All that was handed out is void."""
        if self._used > len(self._buffer):
            self._buffer = np.empty(self._used)
        self._used = 0

    def empty(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Valid until the next `reset`. Where the buffer is too small, it is larger from then on."""
        first, count = self._used, math.prod(shape)
        self._used += count
        if self._used > len(self._buffer):
            return np.empty(shape)
        return self._buffer[first : self._used].reshape(shape)
