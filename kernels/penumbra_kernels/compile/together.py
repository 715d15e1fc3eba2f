"""Which rays of a pixel's paths go through the tree together, sixteen at once (cl/geometry/rays16.cl), and which alone.

Whatever is chosen, the picture is the same, bit for bit; only its time differs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.layout import CONSTANTS

if TYPE_CHECKING:
    from penumbra_kernels.compile.geometry import CompiledGeometry

FEW_NODES: Final = 64
"""Inner nodes of a tree that all rays go through together. Rays that share nothing visit nearly all of a small tree between
them; measured in a room of 36, 300, 1,000, 5,000 triangles, bounces together take .67, .74, .85, .95 of the time alone."""

_TOGETHER: Final = {CONSTANTS["LEAF_TRIANGLES"], CONSTANTS["LEAF_ROUND"]}


def _leaf_kinds(words: NDArray[np.uint32]) -> set[int]:
    leaves = words[(words & CONSTANTS["LEAF_FLAG"]) != 0]
    return set(((leaves >> CONSTANTS["LEAF_TYPE_SHIFT"]) & 3).tolist())


def together(geometry: CompiledGeometry) -> int:
    """OPTION_TOGETHER* bits of a scene's geometry."""
    nodes: NDArray[Any] = geometry.arrays["nodes"]
    words = np.append(nodes["child"].ravel(), np.uint32(geometry.root))
    if geometry.plane_count or len(geometry.arrays["discs"]) or not _leaf_kinds(words) <= _TOGETHER:
        return 0
    alike = CONSTANTS["OPTION_TOGETHER_ALIKE"]
    return alike | CONSTANTS["OPTION_TOGETHER"] if len(nodes) <= FEW_NODES else alike
