"""Reads OBJ, PLY and GLB into triangles, by trimesh. Runs in the decoding process: the file may be hostile.

Only geometry is taken: positions, vertex normals and one set of texture coordinates, (0, 0) at the
image's lower left.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import AssetError, MeshData
from penumbra_scene.limits import MAX_MAGNITUDE
from trimesh.exchange import gltf, obj, ply
from trimesh.scene.transforms import SceneGraph

from penumbra_service.images.limits import DecodeLimits
from penumbra_service.images.obj_indices import beyond_the_end, with_absolute_indices
from penumbra_service.images.ply_polygons import with_equal_faces


@dataclass(frozen=True)
class Part:
    """One mesh of a file, in the file's frame."""

    positions: NDArray[np.float64]
    triangles: NDArray[np.int64]
    normals: NDArray[np.float64] | None
    uvs: NDArray[np.float64] | None


def read_mesh(data: bytes, kind: str, limits: DecodeLimits) -> MeshData:
    """All triangles of the file as one mesh. `kind` is obj, ply or glb. Raises AssetError."""
    readers: dict[str, Callable[[bytes], list[Part]]] = {"obj": _obj, "ply": _ply, "glb": _glb}
    parts = [part for part in readers[kind](data) if len(part.triangles)]
    if not parts:
        raise AssetError("the file has no faces")
    return _checked(_joined(parts), limits)


def _obj(data: bytes) -> list[Part]:
    # Without maintain_order a vertex is split wherever faces give it different normals or uvs.
    file = io.BytesIO(with_absolute_indices(data))
    try:
        found = obj.load_obj(file, skip_materials=True, group_material=True, maintain_order=False)
    except IndexError:
        raise AssetError(beyond_the_end(data)) from None
    return [_part(piece) for piece in found.get("geometry", {"": found}).values() if "faces" in piece]


def _ply(data: bytes) -> list[Part]:
    file = with_equal_faces(data)
    found = ply.load_ply(io.BytesIO(file), fix_texture=False, skip_materials=True)
    _check_ply_counts(data, found)
    if "faces" not in found:
        return []
    if b"texcoord" not in file[: file.find(b"end_header")]:
        return [_part(found)]
    # Texture coordinates of faces, not vertices: vertices are split, which loses their normals' order.
    split = ply.load_ply(io.BytesIO(file), fix_texture=True, skip_materials=True)
    normals = split.pop("vertex_normals", None)
    if normals is not None:
        split["vertex_normals"] = np.empty((len(split["vertices"]), 3))
        split["vertex_normals"][np.ravel(split["faces"])] = np.asarray(normals)[np.ravel(found["faces"])]
    return [_part(split)]


def _check_ply_counts(data: bytes, found: Mapping[str, Any]) -> None:
    """trimesh reads what is there of a text file that was cut short."""
    announced = {
        name: int(count)
        for name, count in re.findall(
            rb"^element\s+(\S+)\s+(\d+)", data[: data.find(b"end_header")], re.MULTILINE
        )
    }
    there = len(found.get("vertices", ()))
    if announced.get(b"vertex", 0) != there:
        raise AssetError(
            f"the header announces {announced.get(b'vertex', 0)} vertices, the file holds {there}"
        )
    if announced.get(b"face", 0) > len(found.get("faces", ())):
        raise AssetError(
            f"the header announces {announced[b'face']} faces, the file holds {len(found.get('faces', ()))}"
        )


def _glb(data: bytes) -> list[Part]:
    found = gltf.load_glb(io.BytesIO(data), skip_materials=True)
    graph = SceneGraph(base_frame=found.get("base_frame", "world"))
    for edge in found["graph"]:
        graph.update(**edge)  # type: ignore[no-untyped-call]
    parts = []
    for node in graph.nodes_geometry:
        matrix, name = graph.get(node)
        piece = found["geometry"][name]
        if "faces" in piece:
            parts.append(_moved(_part(piece), np.asarray(matrix, np.float64)))
    return parts


def _part(piece: Mapping[str, Any]) -> Part:
    positions = np.asarray(piece["vertices"], np.float64).reshape(-1, 3)
    normals = piece.get("vertex_normals")
    visual = piece.get("visual")
    uvs = getattr(visual, "uv", None) if visual is not None else None
    return Part(
        positions,
        _triangles(np.asarray(piece["faces"])),
        _per_vertex(normals, positions, 3),
        _per_vertex(uvs, positions, 2),
    )


def _per_vertex(values: Any, positions: NDArray[Any], width: int) -> NDArray[np.float64] | None:
    if values is None or np.shape(values) != (len(positions), width):
        return None
    return np.asarray(values, np.float64)


def _triangles(faces: NDArray[Any]) -> NDArray[np.int64]:
    """Polygons (m, k) as fans of k - 2 triangles, in order."""
    if faces.ndim != 2 or faces.shape[1] < 3 or faces.dtype.kind not in "iu":
        raise AssetError("a face must have at least 3 vertices")
    corners = faces.astype(np.int64)
    fan = [
        np.stack((corners[:, 0], corners[:, i], corners[:, i + 1]), axis=1)
        for i in range(1, corners.shape[1] - 1)
    ]
    return np.stack(fan, axis=1).reshape(-1, 3)


def _moved(part: Part, matrix: NDArray[np.float64]) -> Part:
    """The part under a node's transform; a mirroring one turns the triangles round, so that outside stays
    outside."""
    linear = matrix[:3, :3]
    mirrors = np.linalg.det(linear) < 0
    normals = part.normals
    if normals is not None:
        # normals go by the cofactor matrix, which exists for singular transforms too
        cofactor = np.cross(linear[:, [1, 2, 0]].T, linear[:, [2, 0, 1]].T).T
        normals = normals @ cofactor.T * (-1.0 if mirrors else 1.0)
    triangles = part.triangles[:, ::-1] if mirrors else part.triangles
    return Part(part.positions @ linear.T + matrix[:3, 3], triangles, normals, part.uvs)


def _joined(parts: list[Part]) -> Part:
    """One part; normals and uvs are kept only where every part has them."""
    if len(parts) == 1:
        return parts[0]
    offsets = np.cumsum([0, *(len(part.positions) for part in parts)])
    normals = [part.normals for part in parts if part.normals is not None]
    uvs = [part.uvs for part in parts if part.uvs is not None]
    return Part(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets, strict=False)]),
        np.concatenate(normals) if len(normals) == len(parts) else None,
        np.concatenate(uvs) if len(uvs) == len(parts) else None,
    )


def _checked(part: Part, limits: DecodeLimits) -> MeshData:
    count = len(part.positions)
    if len(part.triangles) > limits.triangles:
        raise AssetError(
            f"the file has {len(part.triangles)} triangles; at most {limits.triangles} are accepted"
        )
    if count > limits.vertices:
        raise AssetError(f"the file has {count} vertices; at most {limits.vertices} are accepted")
    low, high = int(part.triangles.min()), int(part.triangles.max())
    if low < 0 or high >= count:
        raise AssetError(f"a face refers to vertex {low if low < 0 else high}, but there are only {count}")
    _check_finite("positions", part.positions)
    if part.uvs is not None:
        _check_finite("texture coordinates", part.uvs)
    return MeshData(
        part.positions,
        part.triangles.astype(np.uint32),
        None if part.normals is None else _unit(part.normals),
        None if part.uvs is None else part.uvs.astype(np.float32),
    )


def _check_finite(what: str, values: NDArray[np.float64]) -> None:
    good = np.all(np.abs(values) <= MAX_MAGNITUDE, axis=1)  # false for NaN, too
    if not good.all():
        first = int(np.argmin(good))
        raise AssetError(
            f"{what} must be finite and at most {MAX_MAGNITUDE:g}; "
            f"vertex {first} (from 0) has {values[first].tolist()}"
        )


def _unit(normals: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Normals of length 1; none at all where one cannot be normalised, so that triangles are flat instead
    of wrong."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not (np.isfinite(length).all() and (length > 0).all()):
        return None
    unit: NDArray[np.float32] = (normals / length).astype(np.float32)
    return unit
