"""How large a scene is: what lights from infinitely far away shine on. Metres, relative to the anchor."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.compile.bounds import transformed
from penumbra_kernels.compile.geometry import CompiledGeometry
from penumbra_kernels.layout import CONSTANTS

Box = tuple[NDArray[np.float64], NDArray[np.float64]]

WITHOUT_EXTENT: Final = 1.0
"""Radius of a scene with nothing in it but planes."""


def scene_radius(geometry: CompiledGeometry) -> float:
    """Radius of a sphere around everything but planes, at the shutter's opening."""
    lo, hi = _box(geometry.arrays, geometry.root)
    if not np.all(np.isfinite(hi - lo)) or np.any(lo > hi):
        return WITHOUT_EXTENT
    radius = 0.5 * float(np.linalg.norm(hi - lo))
    return radius if radius > 0.0 else WITHOUT_EXTENT


def _box(arrays: dict[str, NDArray[Any]], word: int) -> Box:
    """Box of what a child word names; inside out where that is nothing."""
    if not word & CONSTANTS["LEAF_FLAG"]:
        return _node_box(arrays["nodes"][word])
    kind = word >> CONSTANTS["LEAF_TYPE_SHIFT"] & 3
    if kind == CONSTANTS["LEAF_ROUND"]:
        return _round_box(arrays, word)
    if kind == CONSTANTS["LEAF_INSTANCE"]:
        record = arrays["instances"][word & CONSTANTS["LEAF_INSTANCE_MASK"]]
        matrix = np.eye(4)
        matrix[:3] = record["world_from_object"]
        return transformed(*_box(arrays, int(record["root"])), matrix)
    deforming = kind == CONSTANTS["LEAF_DEFORMING"]
    count = 1 if deforming else word >> CONSTANTS["LEAF_COUNT_SHIFT"] & 3
    first = word & CONSTANTS["LEAF_PACKET_MASK"]
    packets = arrays["packets"][first : first + count]
    points = np.concatenate([packets[name].transpose(0, 2, 1).reshape(-1, 3) for name in ("v0", "v1", "v2")])
    return points.min(axis=0, initial=np.inf).astype(np.float64), points.max(axis=0, initial=-np.inf).astype(
        np.float64
    )


def _node_box(node: NDArray[Any]) -> Box:
    lo = np.array([node[f"lo_{axis}"].min() for axis in "xyz"], np.float64)
    hi = np.array([node[f"hi_{axis}"].max() for axis in "xyz"], np.float64)
    return lo, hi


def _round_box(arrays: dict[str, NDArray[Any]], word: int) -> Box:
    index = word & CONSTANTS["LEAF_ROUND_MASK"] & ~(1 << CONSTANTS["LEAF_DISC_SHIFT"])
    if word >> CONSTANTS["LEAF_DISC_SHIFT"] & 1:
        record = arrays["discs"][index]
        u, v = (record[name][:3].astype(np.float64) for name in ("u", "v"))
        half = np.sqrt(u * u + v * v)
    else:
        record = arrays["spheres"][index]
        half = np.full(3, float(record["radius"]))
    center = record["center"].astype(np.float64)
    return center - half, center + half
