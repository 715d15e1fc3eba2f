"""No ray slips between triangles that share an edge or a vertex (hard cases 1, 2, 3, 13)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

RAYS = 200_000


def _aimed(rng: np.random.Generator, origin: Any, targets: Any, kit: Any) -> Any:
    origins = np.broadcast_to(np.asarray(origin, np.float64), targets.shape)
    return kit.rays(origins, targets.astype(np.float32).astype(np.float64) - origins)


@pytest.mark.parametrize(("center", "half"), [((0.0, 0.0, 5.0), 2.0), ((148376.0, 1234.0, -223423.0), 2.0)])
def test_no_ray_misses_a_quads_diagonal(probe: Any, kit: Any, center: Any, half: float) -> None:
    rng = np.random.default_rng(1)
    c = np.asarray(center)
    corners = c + half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    meshes = kit.Meshes()
    geometry = kit.compiled([meshes.add(corners, [[0, 1, 2], [0, 2, 3]])], meshes)
    s = rng.uniform(-0.99, 0.99, RAYS) * half
    targets = c + np.stack([s, s, 0 * s], 1)
    origins = c + np.array([0, 0, 10 * half]) + rng.uniform(-half, half, (RAYS, 3))
    origins = origins.astype(np.float32).astype(np.float64)
    answers = probe.trace(geometry, kit.rays(origins, targets - origins))
    assert np.count_nonzero(answers["kind"] == kit.NONE) == 0
    assert answers["occluded"].all()


def _sphere_mesh(n: int) -> tuple[Any, Any]:
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


def _grid(n: int) -> tuple[Any, Any]:
    """A flat grid whose edges are parallel to the axes: every edge is on the border of a box of the tree."""
    x = np.linspace(-1, 1, n + 1)
    vertices = np.array([[a, b, 0.0] for a in x for b in x])
    faces = []
    for i in range(n):
        for j in range(n):
            a, b = i * (n + 1) + j, (i + 1) * (n + 1) + j
            faces += [[a, b, b + 1], [a, b + 1, a + 1]]
    return vertices, np.array(faces)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4])
@pytest.mark.parametrize("target", ["vertices", "edges"])
def test_no_ray_leaves_a_closed_mesh(probe: Any, kit: Any, scale: float, target: str) -> None:
    rng = np.random.default_rng(2)
    vertices, faces = _sphere_mesh(16)
    vertices = (vertices * scale).astype(np.float32).astype(np.float64)
    meshes = kit.Meshes()
    geometry = kit.compiled([meshes.add(vertices, faces)], meshes)
    face = faces[rng.integers(0, len(faces), RAYS)]
    along = rng.random(RAYS)[:, None] if target == "edges" else 0.0
    targets = vertices[face[:, 0]] * (1 - along) + vertices[face[:, 1]] * along
    origins = (rng.uniform(-0.4, 0.4, (RAYS, 3)) * scale).astype(np.float32).astype(np.float64)
    answers = probe.trace(geometry, kit.rays(origins, targets - origins))
    assert np.count_nonzero(answers["kind"] == kit.NONE) == 0
    assert answers["occluded"].all()


@pytest.mark.parametrize("distance", [1e-3, 3.0, 1e3])
def test_no_ray_slips_through_the_edges_of_an_axis_parallel_grid(
    probe: Any, kit: Any, distance: float
) -> None:
    rng = np.random.default_rng(3)
    vertices, faces = _grid(32)
    meshes = kit.Meshes()
    geometry = kit.compiled([meshes.add(vertices + 0.1, faces)], meshes)
    targets = rng.uniform(-0.95, 0.95, (RAYS, 3))
    targets[:, 2] = 0.0
    on_line = np.round((targets + 1) * 16) / 16 - 1  # the grid's lines
    axis = rng.integers(0, 3, RAYS)  # x on a line, y on a line, or both: a vertex
    targets[:, 0] = np.where(axis != 1, on_line[:, 0], targets[:, 0])
    targets[:, 1] = np.where(axis != 0, on_line[:, 1], targets[:, 1])
    targets = targets + 0.1
    away = rng.normal(size=(RAYS, 3)) * distance
    away[:, 2] = np.abs(away[:, 2]) + 0.1 * distance
    away[: RAYS // 4, 0] = 0.0  # in the plane of a line
    origins = (targets + away).astype(np.float32).astype(np.float64)
    answers = probe.trace(geometry, kit.rays(origins, targets - origins))
    assert np.count_nonzero(answers["kind"] == kit.NONE) == 0


def test_axis_parallel_rays_on_slab_planes_hit_what_brute_force_hits(probe: Any, kit: Any) -> None:
    """Zeros of either sign in the direction, origins in the planes of boxes: the same hit as without a
    tree."""
    rng = np.random.default_rng(4)
    vertices, faces = _grid(8)
    meshes = kit.Meshes()
    geometry = kit.compiled([meshes.add(vertices, faces)], meshes)
    k = rng.integers(0, 9, (RAYS // 10, 2)) / 4.0 - 1.0
    origins = np.concatenate([k, np.full((len(k), 1), 1.0)], 1)
    zeros = np.where(rng.random((len(k), 2)) < 0.5, -0.0, 0.0)
    down = np.concatenate([zeros, np.full((len(k), 1), -1.0)], 1)
    answers = probe.trace(geometry, kit.rays(origins, down))
    assert (answers["t"] == 1.0).all()
    # the lowest of the triangles around that grid point
    touching = np.full((9, 9), len(faces))
    for number, face in enumerate(faces):
        for vertex in face:
            i, j = divmod(int(vertex), 9)
            touching[i, j] = min(touching[i, j], number)
    index = np.round((k + 1) * 4).astype(int)
    assert (answers["primitive"] == touching[index[:, 0], index[:, 1]]).all()
