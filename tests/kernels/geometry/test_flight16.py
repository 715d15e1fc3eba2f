"""Claims about the network of cl/geometry/flight16.cl that sorts children. What its rays meet: test_lanes16.py."""

from __future__ import annotations

import numpy as np
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.geometry import EFFECTS

SORT = """
#include "geometry/flight16.cl"

__kernel void probe(__global int *numbers) {
  __global int *row = numbers + 8u * get_global_id(0);
  int8 v;
  for (uint i = 0u; i < 8u; i++) ((int *)&v)[i] = row[i];
  v = sort8(v);
  for (uint i = 0u; i < 8u; i++) row[i] = ((const int *)&v)[i];
}
"""


def test_eight_children_are_sorted_the_largest_first(device: Device) -> None:
    """A network that sorts every row of zeros and ones sorts all numbers (Knuth, volume 3, 5.3.4, theorem Z)."""
    flags = {f"PENUMBRA_{name}": 0 for name in EFFECTS}
    cpu = {"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_COMPACT_TREE": 0}
    kernel = device.build("probe.cl", {**flags, **device.flags, **cpu}, SORT).probe
    rows = (np.arange(256)[:, None] >> np.arange(8) & 1).astype(np.int32)
    out = np.zeros_like(rows)
    buffer = device.upload(rows)
    device.launch(kernel, [buffer], len(rows), 1)
    device.download(buffer, out)
    np.testing.assert_array_equal(out, np.sort(rows, axis=1)[:, ::-1])
