"""Meshes and quads as triangle arrays in their own frame. Metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.shapes import Mesh, Quad

from penumbra_kernels.assets import AssetError, Assets

CHUNK: Final = 1 << 16
"""Triangles looked at together: bounds the memory of temporaries, some 200 bytes for each."""
SCATTER_CHUNK: Final = 1 << 18
"""The same where every chunk costs a pass over all vertices."""
LARGEST: Final = 1e18
"""Metres: larger coordinates do not survive being squared in float32."""


@dataclass(frozen=True)
class Triangles:
    """m triangles over n vertices."""

    positions: NDArray[np.float64]
    """(n, 3)."""
    indices: NDArray[np.uint32]
    """(m, 3), counter-clockwise seen from outside."""
    normals: NDArray[np.float64] | None = None
    """(n, 3), any length."""
    uvs: NDArray[np.float32] | None = None
    """(n, 2)."""


def quad_triangles(quad: Quad) -> Triangles:
    """(origin, +u, +u+v), (origin, +u+v, +v): surface_triangle.cl knows this order for (a, b) as uv."""
    o, u, v = (np.asarray(x, np.float64) for x in (quad.origin, quad.u, quad.v))
    return Triangles(np.array([o, o + u, o + u + v, o + v]), np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


def mesh_triangles(mesh: Mesh, assets: Assets, where: str) -> Triangles:
    """The mesh's arrays, inline or from its asset. Raises AssetError where they are broken."""
    if mesh.source is not None:
        data = assets.mesh(mesh.source)
        normals = None if data.normals is None else np.asarray(data.normals, np.float64)
        found = Triangles(
            np.asarray(data.positions, np.float64), np.asarray(data.indices, np.uint32), normals, data.uvs
        )
    else:
        assert mesh.positions is not None
        assert mesh.indices is not None
        found = Triangles(
            np.asarray(mesh.positions, np.float64).reshape(-1, 3),
            np.asarray(mesh.indices, np.uint32).reshape(-1, 3),
            None if mesh.normals is None else np.asarray(mesh.normals, np.float64),
            None if mesh.uvs is None else np.asarray(mesh.uvs, np.float32),
        )
    _check(found, where)
    if mesh.smooth and found.normals is None:
        return Triangles(
            found.positions, found.indices, smooth_normals(found.positions, found.indices), found.uvs
        )
    return found


def _check(triangles: Triangles, where: str) -> None:
    check_positions(triangles.positions, where)
    indices = triangles.indices
    if indices.size and int(indices.max()) >= len(triangles.positions):
        raise AssetError(
            f"{where}: a triangle names vertex {int(indices.max())} of {len(triangles.positions)}"
        )
    for name, values in (("normal", triangles.normals), ("uv", triangles.uvs)):
        if values is not None and len(values) != len(triangles.positions):
            raise AssetError(f"{where}: {len(values)} {name}s for {len(triangles.positions)} positions")
        if values is not None and not np.isfinite(values).all():
            raise AssetError(f"{where}: a {name} is not finite")


def check_positions(positions: NDArray[Any], where: str) -> None:
    """Raise AssetError where a position is NaN, infinite or beyond LARGEST."""
    for start in range(0, len(positions), CHUNK):
        part = positions[start : start + CHUNK]
        bad = ~(np.abs(part) <= LARGEST).all(axis=1)
        if bad.any():
            vertex = start + int(np.argmax(bad))
            at = tuple(float(x) for x in positions[vertex])
            raise AssetError(f"{where}: vertex {vertex} is at {at}; must be finite and at most {LARGEST:g} m")


def smooth_normals(positions: NDArray[np.float64], indices: NDArray[np.uint32]) -> NDArray[np.float64]:
    """(n, 3) vertex normals, faces weighted by their angle at the vertex (Thurmer and Wuthrich 1998); 0
    where none."""
    normals = np.zeros_like(positions)
    for start in range(0, len(indices), SCATTER_CHUNK):
        part = indices[start : start + SCATTER_CHUNK]
        corners = positions[part]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(face, axis=1, keepdims=True)
        face = np.divide(face, size, out=np.zeros_like(face), where=size > 0)
        for i in range(3):
            a = corners[:, (i + 1) % 3] - corners[:, i]
            b = corners[:, (i + 2) % 3] - corners[:, i]
            angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
            for axis in range(3):
                normals[:, axis] += np.bincount(part[:, i], face[:, axis] * angle, len(positions))
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, size, out=np.zeros_like(normals), where=size > 0))


def with_area(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """(m,): which triangles have any area in float32; those without can never be hit."""
    out = np.empty(len(indices), np.bool_)
    for start in range(0, len(indices), CHUNK):
        corners = positions[indices[start : start + CHUNK]].astype(np.float64)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out[start : start + CHUNK] = (cross != 0.0).any(axis=1)
    return out
