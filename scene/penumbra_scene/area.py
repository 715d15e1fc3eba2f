"""Which shapes have an area: what has none is never met by a ray, and gives no light. In plain Python, metres."""

from __future__ import annotations

import math
from typing import Final

from penumbra_scene.base import Vec3
from penumbra_scene.placement import Affine, placements
from penumbra_scene.shapes import Disc, Instance, Mesh, Plane, Quad, Shape, Sphere

LEAST_AREA: Final = 2.0**-126
"""m^2: the smallest number that float32 holds to full precision. What is smaller is 0 on devices, or nearly."""
MOST_TRIANGLES_LOOKED_AT: Final = 200_000
"""Larger meshes are not searched for flat triangles: that would take longer than all other checks."""
_FLAT: Final = 1e-12
"""Sine of an angle between a triangle's sides that rounding in float64 makes of 0, and more."""


def emits(shape: Shape) -> bool:
    """Whether a shape gives light: it has a radiance and an area. Meshes of an asset are taken to have one."""
    if isinstance(shape, (Plane, Instance)) or shape.emission is None or not any(shape.emission.radiance):
        return False
    return has_area(shape)


def has_area(shape: Sphere | Quad | Disc | Mesh) -> bool:
    """Whether a shape has an area in the world, at any of its keyframes."""
    if isinstance(shape, Mesh):
        return _has_solid_triangle(shape)
    if isinstance(shape, Quad):
        area = _cross(shape.u, shape.v)
    else:
        # A sphere's is at least that of its section.
        normal = shape.normal if isinstance(shape, Disc) else (0.0, 0.0, 1.0)
        length = math.hypot(*normal)
        x, y, z = (math.pi * shape.radius * shape.radius * n / length for n in normal)
        area = (x, y, z)
    return _ever(shape, area)


def flat_triangles(mesh: Mesh) -> int:
    """How many triangles of an inline mesh are points or lines."""
    return sum(_is_flat(mesh, triangle) for triangle in mesh.indices or ())


def _has_solid_triangle(mesh: Mesh) -> bool:
    indices = mesh.indices or ()
    if mesh.deformation or not indices or len(indices) > MOST_TRIANGLES_LOOKED_AT:
        return True
    positions = mesh.positions or ()
    for triangle in indices:
        a, b, c = (positions[i] for i in triangle)
        x, y, z = _cross(_minus(b, a), _minus(c, a))
        if not _on_a_line(a, b, c) and _ever(mesh, (0.5 * x, 0.5 * y, 0.5 * z)):
            return True
    return False


def _ever(shape: Sphere | Quad | Disc | Mesh, area: Vec3) -> bool:
    """Whether an area vector is one in the world at any keyframe of the shape's transform."""
    if not shape.transform:
        return math.hypot(*area) >= LEAST_AREA
    return any(_placed(matrix, area) >= LEAST_AREA for matrix in placements(shape.transform))


def _placed(m: Affine, area: Vec3) -> float:
    """The size of an area vector under a matrix: areas go by the cofactors of its linear part."""
    columns = [(m[0][j], m[1][j], m[2][j]) for j in range(3)]
    cofactors = [_cross(columns[(j + 1) % 3], columns[(j + 2) % 3]) for j in range(3)]
    return math.hypot(*(sum(area[j] * cofactors[j][i] for j in range(3)) for i in range(3)))


def _is_flat(mesh: Mesh, triangle: tuple[int, int, int]) -> bool:
    """Whether the triangle's corners lie on a line, now and (with a deformation) always."""
    frames = [k.positions for k in mesh.deformation] if mesh.deformation else [mesh.positions or ()]
    return all(_on_a_line(*(positions[i] for i in triangle)) for positions in frames)


def _on_a_line(a: Vec3, b: Vec3, c: Vec3) -> bool:
    u, v = _minus(b, a), _minus(c, a)
    x, y, z = _cross(u, v)
    sizes = (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]) * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return x * x + y * y + z * z <= _FLAT * _FLAT * sizes


def _minus(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _cross(u: Vec3, v: Vec3) -> Vec3:
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
