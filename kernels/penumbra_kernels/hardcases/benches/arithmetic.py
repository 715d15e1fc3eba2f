"""Single operations of float32 on a device."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.launch import Kernels

OPERATIONS: Final = {
    "sum": "a[i] * b[i] + c[i]",
    "cross": "a[i] * b[i] - c[i] * d[i]",
    "quotient": "a[i] / b[i]",
    "root": "SQRT(FABS(a[i]))",
}

TEXT: Final = '#include "base/math.cl"\n' + "".join(
    f"__kernel void op_{name}(__global float *out, const __global float *a, const __global float *b,\n"
    "  const __global float *c, const __global float *d) {\n"
    f"  const size_t i = get_global_id(0);\n  out[i] = {expression};\n}}\n"
    for name, expression in OPERATIONS.items()
)


class Arithmetic:
    """arithmetic(operation, a, b, c, d) -> (n,) float32, as the tracer's programs compute it."""

    def __init__(self, device: Device) -> None:
        self._kernels = Kernels(device, "arithmetic", TEXT)

    def __call__(self, name: str, *operands: NDArray[np.float32]) -> NDArray[Any]:
        out = np.empty(len(operands[0]), np.float32)
        self._kernels(f"op_{name}", len(out), out, *operands)
        return out
