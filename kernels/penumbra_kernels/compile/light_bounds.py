"""Bounds of lights for the light tree: where they are while the shutter is open, where to and how strongly they shine.

Metres relative to the anchor, radians. Bounds are conservative: what they leave out, the light cannot do. Strength only
steers the choice: the greatest radiant intensity, W / sr, or a far light's irradiance, W / m^2, mean of red, green and blue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.compile.bounds import BOX_SLACK
from penumbra_kernels.compile.geometry import CompiledGeometry, ShapeRecord
from penumbra_kernels.compile.placement import Motion
from penumbra_kernels.layout import CONSTANTS

Array = NDArray[Any]
Point = NDArray[np.float64]

NONE: Final = CONSTANTS["NONE"]
HALF: Final = 0.5 * math.pi
NO_AXIS: Final = np.zeros(3)


@dataclass(frozen=True)
class LightBounds:
    """One light, as cl/lights/tree.cl weighs it."""

    center: Point
    """Of a sphere around it; of far lights, the unit direction to it."""
    radius: float
    """Negative for far lights."""
    axis: Point
    """Mean direction of its normals, unit, or 0 where they point everywhere."""
    spread: float
    """Angle within which its normals are of the axis; of far lights, the directions to it of the center."""
    falloff: float
    """Angle off a normal beyond which nothing is emitted."""
    strength: float


def _sphere_around(lo: Point, hi: Point) -> tuple[Point, float]:
    return 0.5 * (lo + hi), 0.5 * float(np.linalg.norm(hi - lo))


def _unit(vector: Point) -> Point:
    largest = float(np.abs(vector).max())
    return vector / largest / np.linalg.norm(vector / largest) if largest > 0.0 else NO_AXIS


def _near(
    center: Point, radius: float, axis: Point, spread: float, falloff: float, strength: float
) -> LightBounds:
    """Room for the rounding of single-precision places."""
    wider = radius * (1.0 + 1e-6) + BOX_SLACK * float(np.abs(center).max())
    return LightBounds(center, wider, axis, spread if axis.any() else math.pi, falloff, strength)


class BodyBounds:
    """Bounds of emitting shapes."""

    def __init__(self, geometry: CompiledGeometry) -> None:
        self.geometry = geometry

    def of(self, emitter: ShapeRecord, record: Array, radiance: float, two_sided: bool) -> LightBounds:
        """record: its LIGHT, complete; radiance: mean of red, green and blue, W / (m^2 sr)."""
        area = float(record["area"])
        if int(record["type"]) == CONSTANTS["LIGHT_SPHERE"]:
            normals, projected = np.zeros((0, 3)), 0.25 * area  # Cauchy: a convex body's mean projection
        else:
            normals = self._area_normals(emitter, record)
            # Flat bodies project all of their area, closed ones a quarter.
            projected = max(float(np.linalg.norm(normals.sum(axis=0))), 0.25 * area)
        center, radius = self._place(emitter, record)
        if two_sided or not self._keeps_direction(emitter):
            normals = normals[:0]
        axis, spread = _cone(normals)
        return _near(center, radius, axis, spread, HALF, radiance * projected)

    def _keeps_direction(self, emitter: ShapeRecord) -> bool:
        """Whether normals stay what they are at the shutter's opening."""
        if not emitter.moving:
            return True
        instance = self.geometry.arrays["instances"][emitter.instance]
        spans = (
            (instance["first_keyframe"], instance["keyframe_count"]),
            (instance["inner_first_keyframe"], instance["inner_keyframe_count"]),
        )
        for first, count in spans:
            keys = self.geometry.keyframes[int(first) : int(first) + int(count)]
            for linear in (keys["rotation"], keys["stretch"][..., :3]):
                if not np.array_equal(linear, np.broadcast_to(linear[:1], linear.shape)):
                    return False
        return True

    def _place(self, emitter: ShapeRecord, record: Array) -> tuple[Point, float]:
        if emitter.instance != NONE:
            return _sphere_around(*self.geometry.instance_boxes[emitter.instance])
        position, u, v = (record[name].astype(np.float64) for name in ("position", "direction", "axis_v"))
        kind = int(record["type"])
        if kind == CONSTANTS["LIGHT_SPHERE"]:
            return position, float(record["inner"])
        if kind == CONSTANTS["LIGHT_DISC"]:
            return position, float(max(np.linalg.norm(u), np.linalg.norm(v)))
        quad = kind == CONSTANTS["LIGHT_QUAD"]
        corners = (
            position + np.array([0.0 * u, u, v, u + v]) if quad else self._corners(emitter).reshape(-1, 3)
        )
        return _sphere_around(corners.min(axis=0), corners.max(axis=0))

    def _corners(self, emitter: ShapeRecord) -> NDArray[np.float64]:
        """(n, 3, 3) corners of a mesh's triangles, in the frame of its instance."""
        triangles = self.geometry.arrays["triangles"]["vertex"][emitter.first : emitter.first + emitter.count]
        positions = self.geometry.arrays["positions"].reshape(-1, 3)
        return np.asarray(positions[triangles], np.float64)

    def _area_normals(self, emitter: ShapeRecord, record: Array) -> NDArray[np.float64]:
        """(n, 3) outward normals of its flat parts in the world, as long as their area, at the shutter's opening."""
        if int(record["type"]) == CONSTANTS["LIGHT_MESH"]:
            corners = self._corners(emitter)
            normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            if self.geometry.arrays["shapes"]["flags"][emitter.shape] & CONSTANTS["SHAPE_FLIP"]:
                normals = -normals
        else:
            u, v = (record[name].astype(np.float64) for name in ("direction", "axis_v"))
            normals = np.cross(u, v)[None]
            if int(record["type"]) == CONSTANTS["LIGHT_DISC"]:
                normals *= math.pi
        if emitter.instance != NONE:
            linear = emitter.world_from_object[:3, :3]
            # Areas transform by the cofactors; the inverse alone keeps the outside outside where the matrix mirrors.
            normals = normals @ np.linalg.inv(linear) * abs(np.linalg.det(linear))
        return np.asarray(normals)


def _cone(normals: NDArray[np.float64]) -> tuple[Point, float]:
    """Axis and half angle of a cone around directions of any length (n, 3); zero axis: all directions."""
    sizes = np.linalg.norm(normals, axis=1)
    total = normals.sum(axis=0)
    axis = _unit(total)
    if not axis.any() or np.linalg.norm(total) < 1e-6 * sizes.sum():
        return NO_AXIS, math.pi
    kept = sizes > 0.0
    cosines = (normals[kept] @ axis) / sizes[kept]
    return axis, math.acos(max(-1.0, min(1.0, float(cosines.min()))))


def point_bounds(
    record: Array,
    motion: Motion,
    position: Sequence[float],
    intensity: float,
    cone: tuple[float, float] | None,
) -> LightBounds:
    """A point light at a position in its own frame, or a spot light with its (inner, outer) half angles; record: its
    LIGHT."""
    own = np.asarray(position, np.float64)
    lo, hi = motion.sweep(own[None], own[None])
    center, radius = _sphere_around(lo[0], hi[0])
    if cone is None or motion.moves:
        return _near(center, radius, NO_AXIS, math.pi, HALF, intensity)
    inner, outer = cone
    return _near(center, radius, record["direction"].astype(np.float64), inner, outer - inner, intensity)


def directional_bounds(record: Array, moves: bool, irradiance: float) -> LightBounds:
    """A directional light; record: its LIGHT."""
    to_light = -record["direction"].astype(np.float64)
    return LightBounds(_unit(to_light), -1.0, NO_AXIS, math.pi if moves else 0.0, HALF, irradiance)


def environment_bounds(irradiance: float) -> LightBounds:
    """The environment: light from everywhere."""
    return LightBounds(np.array([0.0, 1.0, 0.0]), -1.0, NO_AXIS, math.pi, HALF, irradiance)
