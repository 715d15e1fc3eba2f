"""Meshes of any size for measurements, made from formulas, so that nothing has to be downloaded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]


def knot(triangles: int) -> Mesh:
    """A tube along a (2, 3) torus knot with a rippled surface: positions (n, 3) within the unit sphere, indices (m, 3),
    m about `triangles`. Its parts face and shade each other, as in scenes that people make."""
    around = max(int((triangles / 16.0) ** 0.5), 3)
    along = max(triangles // (2 * around), 3)
    t = np.arange(along)[:, None] * (2.0 * np.pi / along)
    s = np.arange(around)[None, :] * (2.0 * np.pi / around)

    def spine(t: NDArray[np.float64]) -> NDArray[np.float64]:
        radius = 0.55 + 0.22 * np.cos(3.0 * t)
        return np.stack([radius * np.cos(2.0 * t), 0.22 * np.sin(3.0 * t), radius * np.sin(2.0 * t)], axis=-1)

    center = spine(t)
    forward = spine(t + 1e-4) - spine(t - 1e-4)
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    side = np.cross(forward, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(side, forward)
    ripple = 1.0 + 0.10 * np.sin(40.0 * t + 3.0 * s) + 0.05 * np.sin(97.0 * t - 7.0 * s)
    tube = (0.13 * ripple)[..., None] * (np.cos(s)[..., None] * side + np.sin(s)[..., None] * up)
    positions = (center + tube).reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    a = i * around + j
    b = i * around + (j + 1) % around
    c = (i + 1) % along * around + j
    d = (i + 1) % along * around + (j + 1) % around
    indices = np.stack([np.stack([a, c, b], -1), np.stack([b, c, d], -1)], axis=2).reshape(-1, 3)
    return positions, indices.astype(np.uint32)


def box(lo: NDArray[np.float32], hi: NDArray[np.float32], turn: float = 0.0) -> Mesh:
    """The twelve triangles of a box, turned about its vertical axis by `turn` radians."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    points = lo + corners * (hi - lo)
    middle = (np.asarray(lo) + hi) / 2.0
    c, s = np.cos(turn), np.sin(turn)
    points = (points - middle) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + middle
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    indices = [t for a, b, c_, d in quads for t in ((a, b, c_), (a, c_, d))]
    return points.astype(np.float32), np.array(indices, np.uint32)


def joined(*parts: Mesh) -> Mesh:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(len(p) for p, _ in parts[:-1])])
    return (
        np.concatenate([p for p, _ in parts]),
        np.concatenate([i + np.uint32(o) for (_, i), o in zip(parts, offsets, strict=True)]).astype(
            np.uint32
        ),
    )


def room(triangles: int) -> Mesh:
    """A box of 2 m about the origin with, in it, two boxes (36 triangles in all) or a knot of about `triangles`."""
    walls = box(np.full(3, -1.0, np.float32), np.full(3, 1.0, np.float32))
    if triangles <= 36:
        tall = box(np.array([-0.6, -1.0, -0.6]), np.array([0.0, 0.2, 0.0]), 0.3)
        short = box(np.array([0.05, -1.0, -0.1]), np.array([0.65, -0.4, 0.5]), -0.3)
        return joined(walls, tall, short)
    return joined(walls, knot(triangles - 12))
