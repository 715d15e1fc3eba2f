"""Numbers drawn in lanes are those that each sample draws alone, bit for bit: every sampler, with and without builtins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.hardcases.benches.samplers import LENS, PIXEL, TIME, bounce
from penumbra_kernels.layout import CONSTANTS, PARAMS

KERNEL = """
#include "sampling/sampler16.cl"
// Sixteen samples of `pixels` pixels, which share a vector, from a first one on.
__kernel PENUMBRA_WIDE void draw(__global float *out, const __global Params *params, const __global ulong *firsts,
                                 const ulong dim, const uint pixels, const uint j, const uint m, const uint even) {
  const uint i = get_global_id(0);
  Sampler samplers[LANES];
  Samples samples;
  for (uint k = 0u; k < pixels; k++) samplers[k] = sampler_start(params, 3u * i + k, 7u, 1u);
  for (uint k = 0u; k < BATCH; k++) samples.of[k] = 0u;
  for (uint k = 0u; k < LANES; k++) {
    samples.of[k] = (uchar)(k * pixels / LANES);
    samples.index[k] = firsts[i] + (pixels == 1u ? k : k % (LANES / pixels));
  }
  samples.samplers = samplers;
#if PENUMBRA_ROWS
  samples.even = even;
  samples.shift = LANE_LEVELS - (uint)CTZ(pixels);
  for (uint k = 0u; k < FEW_SAMPLERS; k++) ((ulong *)&samples.keys)[k] = samplers[k % pixels].key;
#endif
  Sampler16 s;
  sampler_start16(&samples, as_uint16(LANE_NUMBERS), LANES, &s);
  const Mask16 on = (Mask16)(-1);
  const float16 number = sample_1d_of16(&s, dim, j, m, on);
  const Point16 point = sample_2d_of16(&s, dim, j, m, on);
  Point16 pair[2];
  const bool follows = dim >= 16ul && (dim & 15ul) == SLOT_LIGHT;
  pair[1].x = pair[1].y = 0.0f;
  sample_pairs16(&s, &on, 1u, dim, follows ? 2u : 1u, pair);
  __global float *to = out + i * LANES * 14u;
  for (uint k = 0u; k < LANES; k++, to += 14) {
    const Sampler one = lane_sampler(&s, k);
    const float2 alone = sample_2d_of(&one, dim, j, m), first = sample_2d(&one, dim);
    const float2 second = follows ? sample_2d(&one, dim + SLOT_DIRECTION - SLOT_LIGHT) : (float2)(0.0f);
    to[0] = LANE_F(number, k);
    to[1] = LANE_F(point.x, k);
    to[2] = LANE_F(point.y, k);
    to[3] = LANE_F(pair[0].x, k);
    to[4] = LANE_F(pair[0].y, k);
    to[5] = LANE_F(pair[1].x, k);
    to[6] = LANE_F(pair[1].y, k);
    to[7] = sample_1d_of(&one, dim, j, m);
    to[8] = alone.x;
    to[9] = alone.y;
    to[10] = first.x;
    to[11] = first.y;
    to[12] = second.x;
    to[13] = second.y;
  }
}
"""
FIRSTS = (0, 1, 13, 48, 96, 1000, (1 << 32) - 5, (1 << 32) + 7)


@pytest.mark.parametrize("portable", [False, True], ids=["native", "portable"])
@pytest.mark.parametrize(
    "sampler", ["regular", "independent", "stratified", "jittered", "sobol", "blue_noise"]
)
def test_lanes_draw_what_each_sample_draws_alone(compiled: Any, sampler: str, portable: bool) -> None:
    """In strata, behind and across them, across 2^32, in dimensions that share a shuffle, and several a sample."""
    flags = {"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_SAMPLER": CONSTANTS[f"SAMPLER_{sampler.upper()}"]}
    if portable:
        flags |= {"PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0}
    launch = compiled(KERNEL, flags)
    firsts = np.array(FIRSTS, np.uint64)
    params = np.zeros((), PARAMS)
    params["seed"], params["replicate_count"], params["film_width"], params["film_height"] = 9, 2, 64, 48
    for strata in (0, 5, 12, 64, 100):
        params["strata"] = strata
        params["log2_samples"] = (strata - 1).bit_length() if strata else 32
        for pixels, even in ((1, 0), (4, 0), (4, 1)):
            for dimension, j, m in (
                (PIXEL, 0, 1),
                (LENS, 1, 3),
                (TIME, 0, 1),
                (bounce(0, 1), 0, 1),
                (bounce(5, 1), 2, 4),
            ):
                out = np.empty((len(firsts), 16, 2, 7), np.float32)
                numbers = np.uint64(dimension), np.uint32(pixels), np.uint32(j), np.uint32(m)
                launch("draw", len(firsts), out, params, firsts, *numbers, np.uint32(even))
                lanes, alone = out[:, :, 0].view(np.uint32), out[:, :, 1].view(np.uint32)
                np.testing.assert_array_equal(
                    lanes, alone, err_msg=f"{strata=} {pixels=} {even=} {dimension=}"
                )
                assert out.min() >= 0
                assert out.max() < 1
