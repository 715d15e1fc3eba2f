"""What the kernels package asks of whoever owns files: decoded images and meshes, nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.assets import AssetRef


class AssetError(ValueError):
    """An asset is missing or cannot be decoded; the message says which and why."""


@dataclass(frozen=True)
class Image:
    """Decoded pixels, as stored in the file (no transfer function removed)."""

    pixels: NDArray[np.float32]
    """(height, width, 3), row 0 at the top; 8-bit values scaled to [0, 1]."""
    eight_bit: bool


@dataclass(frozen=True)
class MeshData:
    """A triangle mesh in its own frame."""

    positions: NDArray[np.float64]
    """(n, 3), metres."""
    indices: NDArray[np.uint32]
    """(m, 3), counter-clockwise seen from outside."""
    normals: NDArray[np.float32] | None = None
    """(n, 3), unit length."""
    uvs: NDArray[np.float32] | None = None
    """(n, 2)."""


class Assets(Protocol):
    """Decoded assets by reference. Raises AssetError."""

    def image(self, ref: AssetRef) -> Image: ...

    def mesh(self, ref: AssetRef) -> MeshData: ...


class NoAssets:
    """For scenes that name none."""

    def image(self, ref: AssetRef) -> Image:
        raise AssetError(f"no asset store here, but the scene names the image {ref.asset or ref.file}")

    def mesh(self, ref: AssetRef) -> MeshData:
        raise AssetError(f"no asset store here, but the scene names the mesh {ref.asset or ref.file}")
