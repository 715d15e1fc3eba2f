"""Writing primitives: float32 records in the frame of the tree that they go into, and their boxes. Metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.shapes import Disc, Mesh, MeshKeyframe, Plane, Quad, Sphere

from penumbra_kernels.accel.build import ALONE, STATIC, Items, Tree, round_word
from penumbra_kernels.aligned import empty
from penumbra_kernels.assets import AssetError, Assets
from penumbra_kernels.compile.bounds import padded
from penumbra_kernels.compile.meshes import (
    CHUNK,
    Triangles,
    check_positions,
    mesh_triangles,
    quad_triangles,
    with_area,
)
from penumbra_kernels.compile.placement import Matrix, Shutter, deforms, form_keys
from penumbra_kernels.compile.transforms import quaternion_of
from penumbra_kernels.layout import CONSTANTS, DISC, PACKET8, PLANE, SPHERE, TRIANGLE

NONE: Final = CONSTANTS["NONE"]


class Vertices:
    """Vertex and primitive arrays as they grow."""

    def __init__(self) -> None:
        self.positions = Growing(np.float32, 3)
        self.normals = Growing(np.float32, 3)
        self.uvs = Growing(np.float32, 2)
        self.triangles = Growing(TRIANGLE)
        self.times: list[float] = []
        self.spheres: list[NDArray[Any]] = []
        self.discs: list[NDArray[Any]] = []
        self.planes: list[NDArray[Any]] = []

    def arrays(self) -> dict[str, NDArray[Any]]:
        """By the names of the tracer's buffers."""
        return {
            "positions": self.positions.array,
            "normals": self.normals.array,
            "uvs": self.uvs.array,
            "triangles": self.triangles.array,
            "times": np.array(self.times, np.float32),
            "spheres": np.array(self.spheres, SPHERE),
            "discs": np.array(self.discs, DISC),
            "planes": np.array(self.planes, PLANE),
        }


class Growing:
    """An array that is appended to, with room that doubles."""

    def __init__(self, dtype: Any, width: int = 0) -> None:
        self._room: NDArray[Any] = np.empty((0, width) if width else (0,), dtype)
        self.count = 0

    def append(self, part: NDArray[Any]) -> int:
        """Index of the part's first entry."""
        first, room = self.extend(len(part))
        room[...] = part
        return first

    def extend(self, count: int) -> tuple[int, NDArray[Any]]:
        """Index of the first of so many more entries, and them, to be written."""
        first, end = self.count, self.count + count
        if end > len(self._room):
            self.reserve(max(end, 2 * len(self._room)) - first)
        self.count = end
        return first, self._room[first:end]

    def reserve(self, count: int) -> None:
        """Have room for so many more entries: pages that are never written are never taken from memory."""
        if self.count + count > len(self._room):
            larger = np.empty((self.count + count, *self._room.shape[1:]), self._room.dtype)
            larger[: self.count] = self.array
            self._room = larger

    @property
    def array(self) -> NDArray[Any]:
        return self._room[: self.count]


class TreeItems:
    """What goes into one tree, as it grows."""

    def __init__(self) -> None:
        self._lo, self._hi = Growing(np.float32, 3), Growing(np.float32, 3)
        self._key, self._word = Growing(np.int32), Growing(np.uint32)
        self._deforming: list[tuple[int, int]] = []  # (keyframes, vertex stride) by key - 1

    @property
    def count(self) -> int:
        """Items so far."""
        return self._lo.count

    def reserve(self, count: int) -> None:
        """Have room for so many more."""
        for part in (self._lo, self._hi, self._key, self._word):
            part.reserve(count)

    def _append(self, lo: NDArray[Any], hi: NDArray[Any], key: int, words: NDArray[np.uint32]) -> None:
        lo32, hi32 = padded(lo, hi)
        if not (np.isfinite(lo32).all() and np.isfinite(hi32).all()):
            raise AssetError("a shape reaches beyond what float32 holds; keep coordinates below 1e18 m")
        self._lo.append(lo32)
        self._hi.append(hi32)
        self._key.append(np.full(len(lo32), key, np.int32))
        self._word.append(words)

    def add(self, lo: NDArray[Any], hi: NDArray[Any], word: int) -> None:
        """One item that is a leaf of its own."""
        self._append(lo, hi, ALONE, np.array([word], np.uint32))

    def add_triangles(
        self, lo: NDArray[Any], hi: NDArray[Any], triangles: NDArray[np.uint32], key: int = STATIC
    ) -> None:
        """Triangles by index: still ones, or those of the deforming mesh with that key."""
        self._append(lo, hi, key, triangles)

    def deforming(self, keyframes: int, stride: int) -> int:
        """The key of one more deforming mesh."""
        self._deforming.append((keyframes, stride))
        return len(self._deforming)

    def split(self, ranges: Sequence[tuple[int, int]]) -> tuple[TreeItems, TreeItems]:
        """All other items, none of them deforming, and those of the ranges [first, end), each in their order."""
        chosen = np.zeros(self.count, bool)
        for first, end in ranges:
            chosen[first:end] = True
        return self._some(~chosen, []), self._some(chosen, self._deforming)

    def _some(self, mask: NDArray[np.bool_], deforming: list[tuple[int, int]]) -> TreeItems:
        some = TreeItems()
        some._deforming = deforming
        for ours, all_of in (
            (some._lo, self._lo),
            (some._hi, self._hi),
            (some._key, self._key),
            (some._word, self._word),
        ):
            ours.append(all_of.array[mask])
        return some

    def copies(self) -> NDArray[np.int64]:
        """By key: packets that a group of triangles takes."""
        return np.array([1, *(keyframes for keyframes, _ in self._deforming)], np.int64)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The box around everything."""
        lo, hi = self._lo.array.min(axis=0), self._hi.array.max(axis=0)
        return lo.astype(np.float64), hi.astype(np.float64)

    def items(self) -> Items:
        """All of them, for build_tree. Triangles have their index where others have their leaf word."""
        return Items(self._lo.array, self._hi.array, self._key.array, self._word.array)

    def packets(self, tree: Tree, vertices: Vertices) -> NDArray[Any]:
        """PACKET8 of the tree's leaves."""
        packets = empty(len(tree.packet_items), PACKET8)
        if not len(packets):
            return packets
        positions, triangles = vertices.positions.array, vertices.triangles.array
        strides = np.array([0, *(stride for _, stride in self._deforming)], np.uint32)
        items = self.items()
        for start in range(0, len(packets), CHUNK // 8):
            part = slice(start, start + CHUNK // 8)
            rows = tree.packet_items[part]
            primitive = items.word[rows]
            packets["primitive"][part] = primitive
            shift = strides[items.key[rows]] * tree.packet_keyframe[part, None].astype(np.uint32)
            corners = triangles["vertex"][primitive] + shift[..., None]
            for i, name in enumerate(("v0", "v1", "v2")):
                packets[name][part] = positions[corners[..., i]].transpose(0, 2, 1)
        return packets


def _mirrors(matrix: Matrix) -> bool:
    return bool(np.linalg.det(matrix[:3, :3]) < 0.0)


def _points(positions: NDArray[np.float64], matrix: Matrix, where: str) -> NDArray[np.float32]:
    if np.array_equal(matrix, np.eye(4)):
        return positions.astype(np.float32)
    moved = positions @ matrix[:3, :3].T + matrix[:3, 3]
    check_positions(moved, f"{where}, transformed")
    return moved.astype(np.float32)


def _normals(normals: NDArray[np.float64], matrix: Matrix) -> NDArray[np.float32]:
    moved = normals @ np.linalg.inv(matrix[:3, :3])
    size = np.abs(moved).max(axis=1, keepdims=True)
    moved = np.divide(moved, size, out=np.zeros_like(moved), where=size > 0)
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    unit = np.divide(moved, length, out=np.zeros_like(moved), where=length > 0)
    return np.asarray(unit, np.float32)


def _boxes(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> tuple[NDArray[Any], NDArray[Any]]:
    a, b, c = (positions[indices[:, i]] for i in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def add_triangles(
    vertices: Vertices,
    items: TreeItems,
    model: Quad | Mesh,
    assets: Assets,
    matrix: Matrix,
    number: int,
    record: NDArray[Any],
    shutter: Shutter,
    where: str,
) -> tuple[int, int]:
    """A quad or mesh under a matrix: (first triangle, count). Fills its SHAPE record; triangles without area
    stay out of the tree."""
    found = quad_triangles(model) if isinstance(model, Quad) else mesh_triangles(model, assets, where)
    keys = _deformation(model, found, shutter, where) if isinstance(model, Mesh) else [(0.0, found.positions)]
    flags = CONSTANTS["SHAPE_FLIP"] if _mirrors(matrix) else 0
    flags |= CONSTANTS["SHAPE_QUAD"] if isinstance(model, Quad) else 0
    first_vertex, count = vertices.positions.count, len(found.positions)
    for _, positions in keys:
        vertices.positions.append(_points(positions, matrix, where))
    placed = [vertices.positions.array[first_vertex + i * count :][:count] for i in range(len(keys))]
    if found.normals is not None:
        flags |= CONSTANTS["SHAPE_HAS_NORMALS"]
        record["normal_offset"] = vertices.normals.count - first_vertex
        for normals in _key_normals(model, found, keys):
            vertices.normals.append(_normals(normals, matrix))
    if found.uvs is not None:
        flags |= CONSTANTS["SHAPE_HAS_UVS"]
        record["uv_offset"] = vertices.uvs.append(np.asarray(found.uvs, np.float32)) - first_vertex
    first, triangles = vertices.triangles.extend(len(found.indices))
    triangles["vertex"] = found.indices
    triangles["vertex"] += np.uint32(first_vertex)
    triangles["shape"] = number
    record["flags"] = flags
    record["first_triangle"], record["triangle_count"] = first, len(triangles)
    if len(keys) > 1:
        record["deform_stride"], record["deform_count"] = len(found.positions), len(keys)
        record["deform_first_time"] = len(vertices.times)
        vertices.times += [time for time, _ in keys]
    _add_boxes(items, placed, found.indices, first)
    return first, len(triangles)


def _add_boxes(
    items: TreeItems, placed: list[NDArray[np.float32]], indices: NDArray[np.uint32], first: int
) -> None:
    """Boxes of triangles whose numbers begin with `first`, over their positions at every keyframe."""
    still = len(placed) == 1
    key = STATIC if still else items.deforming(len(placed), len(placed[0]))
    items.reserve(len(indices))
    for start in range(0, len(indices), CHUNK):
        part = indices[start : start + CHUNK]
        numbers = np.arange(first + start, first + start + len(part), dtype=np.uint32)
        if still:  # collinear at every keyframe can still mean an area in between
            solid = with_area(placed[0], part)
            part, numbers = part[solid], numbers[solid]
        lo, hi = _boxes(placed[0], part)
        for positions in placed[1:]:
            a, b = _boxes(positions, part)
            lo, hi = np.minimum(lo, a), np.maximum(hi, b)
        items.add_triangles(lo, hi, numbers, key)


def _deformation(
    mesh: Mesh, found: Triangles, shutter: Shutter, where: str
) -> list[tuple[float, NDArray[np.float64]]]:
    """(time relative to the frame's, positions) over the shutter interval; one where the mesh keeps its
    form."""
    if mesh.deformation is None:
        return [(0.0, found.positions)]
    if len(mesh.deformation[0].positions) != len(found.positions):
        raise AssetError(
            f"{where}: deformation keyframes have {len(mesh.deformation[0].positions)} positions,"
            f" but the mesh has {len(found.positions)}"
        )
    needed = form_keys(mesh.deformation, shutter.first, shutter.last)
    if deforms(mesh, shutter):
        return [(key.time - shutter.time, np.asarray(key.positions, np.float64)) for key in needed]
    return [(0.0, _positions_at(needed, shutter.first))]


def _positions_at(keys: tuple[MeshKeyframe, ...], time: float) -> NDArray[np.float64]:
    """Between the last keyframe not after `time` and the first not before it."""
    before = max((k for k in keys if k.time <= time), key=lambda k: k.time, default=keys[0])
    after = min((k for k in keys if k.time >= time), key=lambda k: k.time, default=keys[-1])
    a, b = np.asarray(before.positions, np.float64), np.asarray(after.positions, np.float64)
    if after.time <= before.time:
        return a
    return np.asarray(a + (time - before.time) / (after.time - before.time) * (b - a))


def _key_normals(
    model: Quad | Mesh, found: Triangles, keys: list[tuple[float, NDArray[np.float64]]]
) -> list[NDArray[np.float64]]:
    """Vertex normals at every keyframe: computed ones follow the form, given ones stay as they are."""
    from penumbra_kernels.compile.meshes import smooth_normals

    assert found.normals is not None
    computed = (
        isinstance(model, Mesh) and model.smooth and model.normals is None and model.deformation is not None
    )
    return [smooth_normals(positions, found.indices) if computed else found.normals for _, positions in keys]


def add_sphere(
    vertices: Vertices, items: TreeItems, sphere: Sphere, matrix: Matrix, number: int, record: NDArray[Any]
) -> int:
    """A sphere under a similarity; its index. SHAPE_FLIP: the x axis of its frame is mirrored."""
    linear = matrix[:3, :3]
    scale = math.sqrt(float(np.trace(linear.T @ linear)) / 3.0)
    turn = linear / scale
    if _mirrors(matrix):
        record["flags"] = CONSTANTS["SHAPE_FLIP"]
        turn = turn @ np.diag([-1.0, 1.0, 1.0])
    quaternion = np.zeros(4) if np.array_equal(turn, np.eye(3)) else quaternion_of(turn)
    out = np.zeros((), SPHERE)
    out["center"] = linear @ np.asarray(sphere.center) + matrix[:3, 3]
    out["radius"] = scale * sphere.radius
    out["frame"] = quaternion[:3] * (-1.0 if quaternion[3] < 0.0 else 1.0)
    out["shape"] = number
    index = len(vertices.spheres)
    vertices.spheres.append(out)
    center = out["center"].astype(np.float64)[None]
    items.add(center - float(out["radius"]), center + float(out["radius"]), round_word(0, index))
    return index


def axes_of(
    normal: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(u, v, n), right-handed and of unit length: u is +X within the surface, or -Z where the normal is
    along X."""
    n = normal / np.abs(normal).max()
    n = n / np.linalg.norm(n)
    reference = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.9 else np.array([0.0, 0.0, -1.0])
    u = reference - n * (n @ reference)
    u /= np.linalg.norm(u)
    return u, np.cross(n, u), n


def add_disc(
    vertices: Vertices, items: TreeItems, disc: Disc, matrix: Matrix, number: int, record: NDArray[Any]
) -> int:
    """A disc under any affine matrix: an ellipse; its index. SHAPE_FLIP: its own second axis is mirrored."""
    u, v, _ = axes_of(np.asarray(disc.normal, np.float64))
    p, q = (matrix[:3, :3] @ (disc.radius * axis) for axis in (u, v))
    cosine, sine = 1.0, 0.0
    if _mirrors(matrix):
        record["flags"] = CONSTANTS["SHAPE_FLIP"]
        q = -q
    if abs(float(p @ q)) > 1e-9 * float(np.linalg.norm(p) * np.linalg.norm(q)):
        p, q, cosine, sine = _principal(p, q)
    out = np.zeros((), DISC)
    out["center"] = matrix[:3, :3] @ np.asarray(disc.center) + matrix[:3, 3]
    out["u"] = [*p, cosine]
    out["v"] = [*q, sine]
    out["shape"] = number
    index = len(vertices.discs)
    vertices.discs.append(out)
    half = np.sqrt(out["u"][:3].astype(np.float64) ** 2 + out["v"][:3].astype(np.float64) ** 2)
    center = out["center"].astype(np.float64)
    items.add((center - half)[None], (center + half)[None], round_word(1, index))
    return index


def _principal(
    p: NDArray[np.float64], q: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Orthogonal half axes of the ellipse p cos + q sin, and the angle (cosine, sine) that they turned: the
    point (a, b) on them is (cosine a - sine b, sine a + cosine b) on p and q."""
    angle = 0.5 * math.atan2(2.0 * float(p @ q), float(p @ p) - float(q @ q))
    c, s = math.cos(angle), math.sin(angle)
    return c * p + s * q, c * q - s * p, c, s


def add_plane(vertices: Vertices, plane: Plane, matrix: Matrix, number: int) -> int:
    """A plane under a matrix; its index. Its point is the one nearest to the tree's origin, where floats are
    densest."""
    u, v, n = axes_of(np.asarray(plane.normal, np.float64))
    inverse = np.linalg.inv(matrix[:3, :3])
    at = matrix[:3, :3] @ np.asarray(plane.point) + matrix[:3, 3]
    normal = n @ inverse
    normal = normal / np.linalg.norm(normal)
    point = normal * (normal @ at)
    out = np.zeros((), PLANE)
    out["point"], out["normal"][:3], out["shape"] = point, normal, number
    for name, axis in (("tangent_u", u), ("tangent_v", v)):
        gradient = axis @ inverse
        out[name] = [*gradient, gradient @ (point - at)]
    index = len(vertices.planes)
    vertices.planes.append(out)
    return index
