"""Whether all rays of sixteen paths go through the trees together (cl/geometry/rays16.cl), or only those that are alike: camera
rays, and rays from what they meet to lamps; and the corners of triangles for those that go together.

Whatever is chosen, the picture is the same, bit for bit; only its time differs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import CONSTANTS, PACKET_CORNERS

FEW_NODES: Final = 64
"""Inner nodes of all trees, the world's and its instances', where all rays go through them together. Rays that share
nothing visit nearly all of a small tree between them; measured in a room of 36, 300, 1,000, 5,000 triangles, bounces
together take .67, .74, .85, .95 of the time alone."""


def together(arrays: Mapping[str, NDArray[Any]]) -> int:
    """OPTION_TOGETHER, or 0."""
    return CONSTANTS["OPTION_TOGETHER"] if len(arrays["nodes"]) <= FEW_NODES else 0


def packet_corners(packets: NDArray[Any]) -> NDArray[Any]:
    """(p,) of PACKET8 -> (p,) of PACKET_CORNERS: corners that triangles of a packet share stand there once. 416 bytes each."""
    corner = np.stack(
        [packets[name] for name in ("v0", "v1", "v2")], axis=-1
    )  # packet, axis, triangle, which
    corner = corner.reshape(-1, 3, 24).transpose(0, 2, 1)
    bits = np.ascontiguousarray(corner).view(np.uint32)
    first = np.all(bits[:, :, None] == bits[:, None], axis=-1).argmax(axis=-1)  # that has the same place
    new = first == np.arange(24)
    place = np.cumsum(new, axis=1) - 1
    out = np.zeros(len(packets), PACKET_CORNERS)
    rows, columns = np.nonzero(new)
    out["corner"][rows, place[new], :3] = corner[rows, columns]
    out["index"] = np.take_along_axis(place, first, axis=1)
    out["corners"] = new.sum(axis=1)
    primitive = packets["primitive"]
    out["triangles"] = (primitive == primitive[:, -1:]).argmax(axis=1) + 1
    return out
