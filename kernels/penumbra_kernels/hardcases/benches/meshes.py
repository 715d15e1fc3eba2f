"""Meshes that put vertices and edges where ray tracers lose rays. Metres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices (n, 3) and faces (m, 3)."""


def quad(center: Any, half: float) -> Arrays:
    """A square in a plane of constant z, of two triangles that share the diagonal from (-, -) to (+, +)."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return np.asarray(center) + half * corners, np.array([[0, 1, 2], [0, 2, 3]])


def sphere(n: int) -> Arrays:
    """A closed mesh of the unit sphere: rows of latitude, poles as fans."""
    theta = np.linspace(0, np.pi, n + 1)[1:-1]
    phi = np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    rings = [[np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)] for t in theta for p in phi]
    vertices = np.array([[0, 1, 0], *rings, [0, -1, 0]])
    m, faces = len(phi), []
    for j in range(m):
        k = (j + 1) % m
        faces.append([0, 1 + k, 1 + j])
        faces.append([len(vertices) - 1, 1 + (n - 2) * m + j, 1 + (n - 2) * m + k])
        for i in range(n - 2):
            a, b = 1 + i * m, 1 + (i + 1) * m
            faces += [[a + j, a + k, b + k], [a + j, b + k, b + j]]
    return vertices, np.array(faces)


def grid(n: int) -> Arrays:
    """A flat grid whose edges are parallel to the axes: every edge is on the border of a box of the tree."""
    x = np.linspace(-1, 1, n + 1)
    vertices = np.array([[a, b, 0.0] for a in x for b in x])
    faces = []
    for i in range(n):
        for j in range(n):
            a, b = i * (n + 1) + j, (i + 1) * (n + 1) + j
            faces += [[a, b, b + 1], [a, b + 1, a + 1]]
    return vertices, np.array(faces)


def box() -> Arrays:
    """The unit cube, its normals inwards."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    faces = []
    for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)):
        faces += [[a, c, b], [a, d, c]]
    return corners, np.array(faces)


def soup(rng: np.random.Generator, n: int, size: float = 0.2) -> Arrays:
    """n triangles that share nothing, about the unit cube; their vertices are floats."""
    centers = rng.uniform(-1, 1, (n, 1, 3))
    vertices = (centers + rng.normal(size=(n, 3, 3)) * size).reshape(-1, 3)
    return vertices.astype(np.float32).astype(np.float64), np.arange(3 * n).reshape(-1, 3)
