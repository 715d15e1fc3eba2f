"""The real device process with a broken driver: BROKEN says how. `garbage`: one sum in each answer is off by one bit of its
mantissa; `refuse`: the driver has no memory for any launch."""

from __future__ import annotations

import os

import numpy as np
from penumbra_kernels.allotment import Allotment
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_service.engine.device_process import DeviceRefusedError, main
from penumbra_service.engine.opencl import LoadedOnDevice, OpenCLBackend

BROKEN = os.environ["BROKEN"]
_trace = LoadedOnDevice.trace


def _broken(self: LoadedOnDevice, tile: Tile, first: int, count: int, allotment: Allotment | None) -> SumNode:
    if BROKEN == "refuse":
        raise DeviceRefusedError("CL_OUT_OF_RESOURCES")
    node = _trace(self, tile, first, count, allotment)
    value = node.sums["rgba"][0, 0, 0, 0:1]
    value[:] = np.nextafter(value, np.inf)
    return node


LoadedOnDevice.trace = _broken  # type: ignore[method-assign]

if __name__ == "__main__":
    main(OpenCLBackend())
