"""Claims about cl/sampling/ahead.cl: what is drawn for eight samples at once is what each draws for itself, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.layout import CONSTANTS, PARAMS

SAMPLER = {"PENUMBRA_SAMPLER": CONSTANTS["SAMPLER_SOBOL"]}
DIMENSIONS = np.array(
    [0, 1, 2]  # pixel, lens, time
    + [(bounce + 1) * 16 + slot for bounce in (0, 1, 8, 9, 40) for slot in range(6)]
    + [16 + 1 + (1 << 32), 16 + 5 + (3 << 32)],  # of single lights
    np.uint64,
)
ORDERS = {
    "one after the other": np.arange(24),
    "within a block, backwards": np.arange(7, -1, -1),
    "every other one": np.arange(3, 60, 2),
    "back to an earlier block": np.array([0, 9, 1, 8, 17, 0]),
    "beyond 2^32": (1 << 32) + np.arange(-10, 10),
}

DRAW = """
  const uint pixel = get_global_id(0);
  Sampler s = sampler_start(params, pixel, 3u * pixel, 5u);
#if PENUMBRA_AHEAD
  Ahead ahead;
  ahead_start(&s, &ahead);
#endif
  for (uint i = 0u; i < count; i++) {
    sampler_next(&s, indices[i]);
    for (uint k = 0u; k < dimensions; k++) {
      const ulong slot = dims[k] & 15ul;
      const bool single = dims[k] < 16ul ? slot == DIM_TIME : slot != SLOT_LIGHT && slot != SLOT_DIRECTION;
      const float2 u = single ? (float2)(sample_1d(&s, dims[k])) : sample_2d(&s, dims[k]);
      out[(pixel * count + i) * dimensions + k] = u;
    }
  }
"""
ARGUMENTS = "const __global Params *params, const __global ulong *dims, const uint dimensions"
KERNELS = f"""
#include "sampling/sampler.cl"
__kernel void numbers(__global float2 *out, {ARGUMENTS}, const __global ulong *indices, const uint count) {{{DRAW}}}
#if PENUMBRA_AHEAD
__kernel void directions(__global float4 *out, const __global Params *params, const uint count) {{
  const uint pixel = get_global_id(0);
  Sampler s = sampler_start(params, pixel, 7u, 2u);
  Ahead ahead;
  ahead_start(&s, &ahead);
  for (uint i = 0u; i < count; i++) {{
    sampler_next(&s, i / 12u);
    const SquarePoint at = sample_direction(&s, i % 12u);
    float pdf;
    const float3 d = square_to_cosine_hemisphere(at.u, &pdf);
    out[pixel * count + i] = (float4)(at.cosine - d, at.has_cosine ? 0.0f : 1.0f);
  }}
}}
#endif
"""


def params() -> NDArray[Any]:
    made = np.zeros(1, PARAMS)
    made["seed"], made["film_width"], made["film_height"] = 77, 64, 64
    return made


@pytest.mark.parametrize("order", list(ORDERS))
def test_numbers_drawn_ahead_are_those_drawn_alone(compiled: Any, order: str) -> None:
    indices = ORDERS[order].astype(np.uint64)
    drawn = []
    for ahead in (0, 1):
        out = np.empty((16, len(indices), len(DIMENSIONS), 2), np.float32)
        arguments = (params(), DIMENSIONS, np.uint32(len(DIMENSIONS)), indices, np.uint32(len(indices)))
        compiled(KERNELS, SAMPLER | {"PENUMBRA_AHEAD": ahead})("numbers", 16, out, *arguments)
        drawn.append(out)
    assert (drawn[0].view(np.uint32) == drawn[1].view(np.uint32)).all()
    assert len(np.unique(drawn[0])) > 0.9 * drawn[0].size / 2


def test_directions_drawn_ahead_are_those_of_their_points(compiled: Any) -> None:
    out = np.empty((16, 240, 4), np.float32)
    compiled(KERNELS, SAMPLER | {"PENUMBRA_AHEAD": 1})("directions", 16, out, params(), np.uint32(240))
    assert (out == 0).all()
