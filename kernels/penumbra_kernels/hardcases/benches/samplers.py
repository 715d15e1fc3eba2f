"""Samplers on a device: numbers in [0, 1) for any key."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.launch import Kernels
from penumbra_kernels.layout import CONSTANTS, PARAMS

KERNELS: Final = """
#include "sampling/sampler.cl"
// keys: pixel (x, y << 32), replicate, index, dimension.
__kernel void draw_1d(__global float *out, const __global Params *params, const __global ulong *keys,
                      const uint m) {
  const uint i = get_global_id(0);
  const __global ulong *k = keys + 4 * i;
  Sampler s = sampler_start(params, (uint)k[0], (uint)(k[0] >> 32), (uint)k[1]);
  sampler_next(&s, m ? k[2] / m : k[2]);
  out[i] = m ? sample_1d_of(&s, k[3], (uint)(k[2] % m), m) : sample_1d(&s, k[3]);
}
__kernel void draw_2d(__global float2 *out, const __global Params *params, const __global ulong *keys,
                      const uint m) {
  const uint i = get_global_id(0);
  const __global ulong *k = keys + 4 * i;
  Sampler s = sampler_start(params, (uint)k[0], (uint)(k[0] >> 32), (uint)k[1]);
  sampler_next(&s, m ? k[2] / m : k[2]);
  out[i] = m ? sample_2d_of(&s, k[3], (uint)(k[2] % m), m) : sample_2d(&s, k[3]);
}
"""

PIXEL, LENS, TIME = 0, 1, 2


def bounce(number: int, slot: int, light: int = -1) -> int:
    """The dimension's number, as base/dimensions.h makes it."""
    return (number + 1) * 16 + slot + ((light + 1) << 32)


class Draw:
    """A sampler on a device, with launch parameters."""

    def __init__(self, device: Device, name: str) -> None:
        self.name = name
        flags = {"PENUMBRA_SAMPLER": CONSTANTS[f"SAMPLER_{name.upper()}"]}
        self._kernels = Kernels(device, "samplers", KERNELS, flags)

    def __call__(
        self,
        side: int,
        dimension: Any,
        index: Any = 0,
        x: Any = 0,
        y: Any = 0,
        replicate: Any = 0,
        *,
        m: int = 0,
        strata: int = 0,
        seed: int = 0,
        replicates: int = 1,
        film: int = 64,
    ) -> NDArray[np.float32]:
        """Points for all keys, broadcast against each other: shape (...) for side 1, (..., 2) for side 2."""
        shape = np.broadcast_shapes(*(np.shape(v) for v in (x, y, replicate, index, dimension)))
        pixel = np.asarray(x, np.uint64) | (np.asarray(y, np.uint64) << np.uint64(32))
        columns = [
            np.broadcast_to(np.asarray(v, np.uint64), shape) for v in (pixel, replicate, index, dimension)
        ]
        keys = np.stack(columns, axis=-1).reshape(-1, 4)
        params = np.zeros((), PARAMS)
        params["seed"], params["strata"], params["replicate_count"] = seed, strata, replicates
        params["film_width"] = params["film_height"] = film
        params["log2_samples"] = (strata - 1).bit_length() if strata else 32
        out = np.empty((len(keys), 2) if side == 2 else len(keys), np.float32)
        self._kernels(f"draw_{side}d", len(keys), out, params, keys, np.uint32(m))
        return out.reshape((*shape, 2) if side == 2 else shape)


def eight_dimensions(draw: Draw, index: Any, x: Any, replicate: Any, **keys: Any) -> NDArray[np.float64]:
    """Four padded pairs: (..., 8)."""
    names = (PIXEL if draw.name != "stratified" else bounce(2, 3), LENS, bounce(0, 1), bounce(0, 3))
    parts = [draw(2, d, index, x, 0, replicate, **keys) for d in names]
    return np.concatenate(parts, axis=-1).astype(np.float64)


SEQUENCES: Final = """
#include "sampling/sampler.cl"
__kernel void extremes(__global uint2 *out, const uint step) {  // over 32-bit inputs with these 12 high bits
  const uint i = get_global_id(0);
  uint low = 0xffffffffu, high = 0u;
  for (uint k = 0; k < (1u << 20); k += step) {
    const uint u = as_uint(uniform_of((i << 20) | k));  // ordered as floats, negative ones above all
    const uint v = as_uint(uniform_of((i << 20) | (k + step - 1u)));
    low = MIN(low, u);
    high = MAX(high, MAX(u, v));
  }
  out[i] = (uint2)(low, high);
}
__kernel void keys(__global ulong *out, const ulong seed, const uint width) {
  const uint i = get_global_id(0);
  out[i] = pixel_key(seed, i % width, i / width, 3u);
}
"""


class Sequences(Kernels):
    """What samplers are made of: uniform numbers and pixel keys."""

    def __init__(self, device: Device) -> None:
        super().__init__(
            device, "sequences", SEQUENCES, {"PENUMBRA_SAMPLER": CONSTANTS["SAMPLER_INDEPENDENT"]}
        )
