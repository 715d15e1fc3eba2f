"""Claims about packing in cl/base/lanes16.cl: what is packed out of some lanes goes back into the same ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

VECTORS = 512
KERNEL = """
#include "base/lanes16.cl"
__kernel void pack(__global uint *out, const __global float *values, const __global uint *lanes, const __global uint *bits) {
  const uint w = (uint)get_global_id(0);
  float packed[LANES];
  store_lanes16(*(const __global float16 *)(values + LANES * w), lanes[w], packed);
  __global uint *row = out + (LANES + 1u) * w;
  row[0] = deposit_bits(bits[w], lanes[w]);
  for (uint k = 0u; k < LANES; k++) row[1u + k] = k < POPCOUNT(lanes[w]) ? as_uint(packed[k]) : 0u;
}
"""


@pytest.mark.parametrize("portable", [False, True])
def test_packed_lanes_go_back_to_where_they_were(compiled: Any, portable: bool) -> None:
    rng = np.random.default_rng(1)
    values = rng.random((VECTORS, 16), np.float32)
    lanes = rng.integers(0, 1 << 16, VECTORS, np.uint32)
    lanes[:4] = 0, 0xFFFF, 1, 0x8000
    bits = rng.integers(0, 1 << 32, VECTORS, np.uint32)
    flags = {"PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0} if portable else {}
    out = np.empty((VECTORS, 17), np.uint32)
    compiled(KERNEL, flags)("pack", VECTORS, out, values, lanes, bits)
    for w in range(VECTORS):
        on = [k for k in range(16) if lanes[w] >> k & 1]
        assert out[w, 0] == sum(int(bits[w]) >> i & 1 and 1 << k for i, k in enumerate(on))
        packed = out[w, 1 : 1 + len(on)].view(np.float32)
        np.testing.assert_array_equal(packed, values[w, on])
