"""Whether all rays of sixteen paths go through the trees together (cl/geometry/rays16.cl), or only those that are alike: camera
rays, and rays from what they meet to lamps.

Whatever is chosen, the picture is the same, bit for bit; only its time differs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from numpy.typing import NDArray

from penumbra_kernels.layout import CONSTANTS

if TYPE_CHECKING:
    from penumbra_kernels.compile.geometry import CompiledGeometry

FEW_NODES: Final = 64
"""Inner nodes of all trees, the world's and its instances', where all rays go through them together. Rays that share
nothing visit nearly all of a small tree between them; measured in a room of 36, 300, 1,000, 5,000 triangles, bounces
together take .67, .74, .85, .95 of the time alone."""


def together(geometry: CompiledGeometry) -> int:
    """OPTION_TOGETHER, or 0."""
    nodes: NDArray[Any] = geometry.arrays["nodes"]
    return CONSTANTS["OPTION_TOGETHER"] if len(nodes) <= FEW_NODES else 0
