"""Brute force in float64: every primitive of a scene against every ray, from the scene's JSON alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.compile.transforms import matrix_at
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Disc, Instance, Mesh, Plane, Quad, Sphere

Array = NDArray[np.float64]
EDGE = 1e-4
"""Barycentrics and the like nearer than this to an edge are not judged: float32 may fall on either side."""


@dataclass
class Nearest:
    """The nearest hit of each ray so far."""

    t: Array
    normal: Array
    shape: NDArray[np.int64]
    doubtful: NDArray[np.bool_]
    """Some primitive's edge is near the ray, so that float32 may see another."""
    second: Array = field(init=False)

    def __post_init__(self) -> None:
        self.second = self.t.copy()

    def offer(self, t: Array, inside: Array, normal: Array, shape: int) -> None:
        """t (n,), NaN or <= 0 for none; inside: how far from the primitive's edge, negative outside; normal
        (n, 3)."""
        ahead = (t > 0) & np.isfinite(t)
        self.doubtful |= ahead & (np.abs(inside) < EDGE) & (t < self.t * 1.001)
        hit = ahead & (inside > 0)
        nearer = hit & (t < self.t)
        self.second = np.where(nearer, self.t, np.where(hit, np.minimum(self.second, t), self.second))
        self.t = np.where(nearer, t, self.t)
        self.normal = np.where(nearer[:, None], normal, self.normal)
        self.shape = np.where(nearer, shape, self.shape)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


def _triangles(v: Array, o: Array, d: Array, near: Nearest, shape: int, flip: bool) -> None:
    for a, b, c in v:
        e1, e2 = b - a, c - a
        n = np.cross(e1, e2)
        if not n.any():
            continue
        p = np.cross(d, e2)
        with np.errstate(all="ignore"):
            inverse = 1.0 / _dot(p, e1)
            s = o - a
            u = _dot(s, p) * inverse
            q = np.cross(s, e1)
            w = _dot(d, q) * inverse
            t = _dot(q, e2) * inverse
        n = n / np.linalg.norm(n) * (-1 if flip else 1)
        near.offer(t, np.minimum(np.minimum(u, w), 1 - u - w), np.broadcast_to(n, o.shape), shape)


def _sphere(sphere: Sphere, m: Array, o: Array, d: Array, near: Nearest, shape: int) -> None:
    inverse = np.linalg.inv(m)
    f = o @ inverse[:3, :3].T + inverse[:3, 3] - np.asarray(sphere.center)
    e = d @ inverse[:3, :3].T
    a, b, c = _dot(e, e), _dot(f, e), _dot(f, f) - sphere.radius**2
    room = b * b - a * c
    root = np.sqrt(np.maximum(room, 0))
    for t in ((-b - root) / a, (-b + root) / a):
        n = (f + t[:, None] * e) @ inverse[:3, :3]
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        near.offer(t, room / a / sphere.radius**2, n, shape)


def _disc(disc: Disc, m: Array, o: Array, d: Array, near: Nearest, shape: int) -> None:
    inverse = np.linalg.inv(m)
    f, e = o @ inverse[:3, :3].T + inverse[:3, 3], d @ inverse[:3, :3].T
    n = np.asarray(disc.normal) / np.linalg.norm(disc.normal)
    with np.errstate(all="ignore"):
        t = _dot(np.asarray(disc.center) - f, n) / _dot(e, n)
        r = np.linalg.norm(f + t[:, None] * e - np.asarray(disc.center), axis=1) / disc.radius
    world = n @ inverse[:3, :3]
    near.offer(t, 1 - r, np.broadcast_to(world / np.linalg.norm(world), o.shape), shape)


def _plane(plane: Plane, m: Array, o: Array, d: Array, near: Nearest, shape: int) -> None:
    n = np.asarray(plane.normal) @ np.linalg.inv(m)[:3, :3]
    n /= np.linalg.norm(n)
    at = m[:3, :3] @ np.asarray(plane.point) + m[:3, 3]
    with np.errstate(all="ignore"):
        t = _dot(at - o, n) / _dot(d, n)
    near.offer(t, np.ones(len(o)), np.broadcast_to(n, o.shape), shape)


def _mesh_positions(mesh: Mesh, time: float) -> Array:
    if mesh.deformation is None:
        return np.asarray(mesh.positions, np.float64)
    times = [k.time for k in mesh.deformation]
    keys = np.array([k.positions for k in mesh.deformation])
    i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    w = float(np.clip((time - times[i]) / (times[i + 1] - times[i]), 0, 1))
    return np.asarray((1 - w) * keys[i] + w * keys[i + 1])


def _surface(model: Any, m: Array, time: float, o: Array, d: Array, near: Nearest, shape: int) -> None:
    if isinstance(model, Sphere):
        _sphere(model, m, o, d, near, shape)
    elif isinstance(model, Disc):
        _disc(model, m, o, d, near, shape)
    elif isinstance(model, Plane):
        _plane(model, m, o, d, near, shape)
    else:
        if isinstance(model, Quad):
            a, u, v = (np.asarray(x) for x in (model.origin, model.u, model.v))
            points, faces = np.array([a, a + u, a + u + v, a + v]), np.array([[0, 1, 2], [0, 2, 3]])
        else:
            points, faces = _mesh_positions(model, time), np.asarray(model.indices)
        points = points @ m[:3, :3].T + m[:3, 3]
        _triangles(points[faces], o, d, near, shape, bool(np.linalg.det(m[:3, :3]) < 0))


def nearest(scene: Scene, origins: Array, directions: Array, time: float) -> Nearest:
    """The nearest hits at one absolute time; `shape` is the index in scene.shapes, -1 for a miss."""
    n = len(origins)
    near = Nearest(np.full(n, np.inf), np.zeros((n, 3)), np.full(n, -1), np.zeros(n, np.bool_))
    for i, shape in enumerate(scene.shapes):
        outer = matrix_at(shape.transform, time)
        if isinstance(shape, Instance):
            for model in scene.prototypes[shape.prototype]:
                inner = outer @ matrix_at(model.transform, time)
                _surface(model, inner, time, origins, directions, near, i)
        else:
            _surface(shape, outer, time, origins, directions, near, i)
    return near
