"""Lights -> LIGHT records, the table that chooses among them, triangle CDFs, the environment.

An emitting shape is one light, each placed copy of a prototype's too; then come the scene's own lights, the
environment last. Geometry is metres relative to the anchor, or in the frame of the instance that carries the
light. Powers, which only steer the choice, are watts, the mean of red, green and blue.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.lights import ConstantEnvironment, DirectionalLight, PointLight, SpotLight
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Disc, Mesh, Quad, Sphere

from penumbra_kernels.assets import Assets
from penumbra_kernels.compile.alias import STEPS, alias_table, quantised_cdf
from penumbra_kernels.compile.environment import compile_environment
from penumbra_kernels.compile.extent import scene_radius
from penumbra_kernels.compile.geometry import CompiledGeometry, ShapeRecord
from penumbra_kernels.compile.light_bounds import (
    BodyBounds,
    LightBounds,
    directional_bounds,
    environment_bounds,
    point_bounds,
)
from penumbra_kernels.compile.light_tree import build_light_tree
from penumbra_kernels.compile.placement import Motion, Shutter
from penumbra_kernels.features import light_selection
from penumbra_kernels.layout import CONSTANTS, KEYFRAME, LIGHT, LIGHT_NODE

Array = NDArray[Any]
NONE: Final = CONSTANTS["NONE"]
FAR: Final = (CONSTANTS["LIGHT_DIRECTIONAL"], CONSTANTS["LIGHT_ENVIRONMENT"])
"""Types of lights at infinity."""


@dataclass(frozen=True)
class CompiledLights:
    """Everything that cl/lights reads."""

    arrays: dict[str, Array]
    """lights, light_table, light_nodes, emitter_cdf, environment."""
    keyframes: Array
    """(n,) of KEYFRAME, of lights without a body; their indices count from the end of the geometry's."""
    light_count: int
    """Without the environment."""
    environment_light: int
    """Its index, or NONE."""


class _Compiler:
    def __init__(
        self, scene: Scene, geometry: CompiledGeometry, time: float, anchor: NDArray[np.float64]
    ) -> None:
        self.scene, self.geometry, self.anchor = scene, geometry, anchor
        self.shutter = Shutter(time, scene.camera.shutter.open, scene.camera.shutter.close)
        self.lights: list[Array] = []
        self.powers: list[float] = []
        self.cdfs: list[NDArray[np.float32]] = []
        self.cdf_count = 0
        self.keyframes: list[Array] = []
        self.keyframe_count = 0
        self.environment: NDArray[np.float32] = np.zeros((0, 4), np.float32)
        self.radius = scene_radius(geometry)
        self.bodies = BodyBounds(geometry)
        self.selection = light_selection(scene)
        self.bounds: list[LightBounds] = []

    def _record(self, kind: str, radiance: tuple[float, float, float]) -> Array:
        record = np.zeros((), LIGHT)
        record["type"] = CONSTANTS[f"LIGHT_{kind}"]
        record["radiance"] = radiance
        record["shape"] = NONE
        record["instance"] = NONE
        return record

    def _add(self, record: Array, power: float) -> None:
        self.lights.append(record)
        self.powers.append(power)

    def emitter(self, emitter: ShapeRecord) -> None:
        model = emitter.model
        assert isinstance(model, Sphere | Quad | Disc | Mesh)
        assert model.emission is not None
        record = self._record(type(model).__name__.upper(), model.emission.radiance)
        record["shape"], record["instance"] = emitter.shape, emitter.instance
        if isinstance(model, Quad):
            area = _quad(record, model, emitter)
        elif isinstance(model, Disc):
            area = _disc(record, self.geometry.arrays["discs"][emitter.first], emitter)
        elif isinstance(model, Sphere):
            area = _sphere(record, self.geometry.arrays["spheres"][emitter.first], emitter)
        else:
            area = self._mesh(record, emitter)
        record["area"] = area
        sides = 2.0 if model.emission.two_sided else 1.0
        record["flags"] = CONSTANTS["LIGHT_TWO_SIDED"] if model.emission.two_sided else 0
        self.geometry.arrays["shapes"]["light"][emitter.shape] = len(self.lights)
        radiance = _mean(model.emission.radiance)
        self._add(record, math.pi * area * sides * radiance)
        if self.selection == "tree":
            self.bounds.append(self.bodies.of(emitter, record, radiance, model.emission.two_sided))

    def _mesh(self, record: Array, emitter: ShapeRecord) -> float:
        triangles = self.geometry.arrays["triangles"][emitter.first : emitter.first + emitter.count]
        corners = self.geometry.arrays["positions"].reshape(-1, 3)[triangles["vertex"]].astype(np.float64)
        cdf = (quantised_cdf(_areas(corners)) / STEPS).astype(np.float32)
        record["first_cdf"], record["triangle_count"] = self.cdf_count, emitter.count
        record["first_triangle"] = emitter.first
        self.cdfs.append(cdf)
        self.cdf_count += len(cdf)
        if emitter.instance != NONE:
            corners = corners @ emitter.world_from_object[:3, :3].T
        return float(_areas(corners).sum())

    def bodiless(self, light: PointLight | SpotLight | DirectionalLight) -> None:
        motion = Motion.of(light.transform, self.shutter, self.anchor)
        matrix = np.eye(4) if motion.moves else motion.start
        if isinstance(light, DirectionalLight):
            record, power = self._directional(light, matrix)
        else:
            record, power = self._point(light, matrix)
        if motion.moves:
            keys = motion.keyframes()
            record["first_keyframe"] = len(self.geometry.keyframes) + self.keyframe_count
            record["keyframe_count"] = len(keys)
            self.keyframes.append(keys)
            self.keyframe_count += len(keys)
        self._add(record, power)
        if isinstance(light, DirectionalLight):
            self.bounds.append(directional_bounds(record, motion.moves, _mean(light.irradiance)))
        else:
            cone = _cone(light) if isinstance(light, SpotLight) else None
            self.bounds.append(point_bounds(record, motion, light.position, _mean(light.intensity), cone))

    def _directional(self, light: DirectionalLight, matrix: NDArray[np.float64]) -> tuple[Array, float]:
        record = self._record("DIRECTIONAL", light.irradiance)
        record["direction"] = _unit(matrix[:3, :3] @ _unit(np.asarray(light.direction, np.float64)))
        return record, _mean(light.irradiance) * math.pi * self.radius**2

    def _point(self, light: PointLight | SpotLight, matrix: NDArray[np.float64]) -> tuple[Array, float]:
        record = self._record(light.type.upper(), light.intensity)
        record["position"] = matrix[:3, :3] @ np.asarray(light.position, np.float64) + matrix[:3, 3]
        if isinstance(light, PointLight):
            return record, 4.0 * math.pi * _mean(light.intensity)
        record["direction"] = _unit(matrix[:3, :3] @ _unit(np.asarray(light.direction, np.float64)))
        inner, outer = (2.0 * math.sin(0.5 * a) ** 2 for a in _cone(light))
        record["inner"], record["outer"] = inner, outer
        # The smooth step between the cones is 1/2 in the mean over the cosine.
        return record, math.pi * (inner + outer) * _mean(light.intensity)

    def surroundings(self, assets: Assets) -> int:
        """Adds the environment; its index, or NONE."""
        environment = self.scene.environment
        if environment is None:
            return NONE
        disc = math.pi * self.radius**2
        if isinstance(environment, ConstantEnvironment):
            record = self._record("ENVIRONMENT", environment.radiance)
            flux = 4.0 * math.pi * _mean(environment.radiance)
        else:
            record = self._record("ENVIRONMENT", (1.0, 1.0, 1.0))
            image = compile_environment(environment, assets, self.shutter.first)
            flux = image.flux
            self.environment = image.buffer
            record["width"], record["height"], record["first_cdf"] = (
                image.width,
                image.height,
                image.first_cdf,
            )
            record["position"], record["direction"], record["axis_v"] = image.environment_from_world
        self._add(record, flux * disc)
        self.bounds.append(
            environment_bounds(0.25 * flux)
        )  # a plane's irradiance, in the mean over its directions
        return len(self.lights) - 1

    def result(self, environment_light: int) -> CompiledLights:
        lights = np.array(self.lights, LIGHT)
        far = np.isin(lights["type"], FAR)
        table = alias_table(_weights(self.powers, far, self.scene.integrator.light_selection))
        lights["pmf"] = table["pmf"]
        nodes = self._tree(lights)
        arrays: dict[str, Array] = {
            "lights": lights,
            "light_table": table,
            "light_nodes": nodes,
            "emitter_cdf": np.concatenate([np.zeros(0, np.float32), *self.cdfs]),
            "environment": self.environment,
        }
        keyframes = np.concatenate([np.zeros(0, KEYFRAME), *self.keyframes])
        count = len(lights) - (environment_light != NONE)
        return CompiledLights(arrays, keyframes, count, environment_light)

    def _tree(self, lights: Array) -> Array:
        """The light tree's nodes; its leaves go into the records. Without it, nothing."""
        if self.selection != "tree":
            return np.zeros(0, LIGHT_NODE)
        tree = build_light_tree(self.bounds)
        lights["leaf"] = tree.leaf
        return tree.nodes


def _cone(light: SpotLight) -> tuple[float, float]:
    """Half angles, radians."""
    return math.radians(light.inner_cone_angle), math.radians(light.outer_cone_angle)


def _mean(color: tuple[float, float, float]) -> float:
    return sum(color) / 3.0


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    scaled = vector / np.abs(vector).max()
    return np.asarray(scaled / np.linalg.norm(scaled))


def _areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) areas of triangles (n, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def _quad(record: Array, quad: Quad, emitter: ShapeRecord) -> float:
    """Fills in origin and edges, u x v on the outside; returns the area in the world."""
    world = emitter.world_from_object
    edges = [world[:3, :3] @ np.asarray(e, np.float64) for e in (quad.u, quad.v)]
    if emitter.instance != NONE:
        record["position"], record["direction"], record["axis_v"] = quad.origin, quad.u, quad.v
    else:
        u, v = edges if np.linalg.det(world[:3, :3]) > 0.0 else reversed(edges)
        record["position"] = world[:3, :3] @ np.asarray(quad.origin, np.float64) + world[:3, 3]
        record["direction"], record["axis_v"] = u, v
    return float(np.linalg.norm(np.cross(edges[0], edges[1])))


def _disc(record: Array, disc: Array, emitter: ShapeRecord) -> float:
    """Fills in center and half axes, those that rays are tested against; returns the area in the world."""
    record["position"], record["direction"], record["axis_v"] = disc["center"], disc["u"][:3], disc["v"][:3]
    axes = [np.asarray(disc[name][:3], np.float64) for name in ("u", "v")]
    if emitter.instance != NONE:
        axes = [emitter.world_from_object[:3, :3] @ axis for axis in axes]
    return math.pi * float(np.linalg.norm(np.cross(axes[0], axes[1])))


def _sphere(record: Array, sphere: Array, emitter: ShapeRecord) -> float:
    """Fills in center and radius; returns the area in the world, maybe of an ellipsoid."""
    record["position"], record["inner"] = sphere["center"], sphere["radius"]
    radius = float(sphere["radius"])
    if emitter.instance == NONE:
        return 4.0 * math.pi * radius**2
    from scipy.special import elliprg

    a, b, c = (radius * np.linalg.svd(emitter.world_from_object[:3, :3], compute_uv=False)) ** 2
    return 4.0 * math.pi * float(elliprg(a * b, a * c, b * c))  # Carlson 1995, DLMF 19.33.2


def _weights(powers: list[float], far: NDArray[np.bool_], selection: str) -> NDArray[np.float64]:
    """What the choice goes by. A single light is always asked, so that programs without the choice agree.

    The power of lights at infinity grows with the scene's size, whatever reaches the point that is lit: beside others they
    have half of the choice together, as in the tree.
    """
    weights = np.array(powers, np.float64)
    if len(weights) == 1:
        return np.ones(1)
    if selection == "uniform":
        return (weights > 0.0).astype(np.float64)
    sums = [float(weights[group].sum()) for group in (far, ~far)]
    if min(sums) > 0.0:
        weights = weights / np.where(far, *sums)
    return weights


def compile_lights(
    scene: Scene, geometry: CompiledGeometry, time: float, anchor: NDArray[np.float64], assets: Assets
) -> CompiledLights:
    """The lights of the frame at `time` seconds; writes their indices into the geometry's shapes.

    Raises AssetError for a missing or broken environment image, ValueError for too many lights.
    """
    compiler = _Compiler(scene, geometry, time, np.asarray(anchor, np.float64))
    for emitter in geometry.emitters:
        compiler.emitter(emitter)
    for light in scene.lights:
        compiler.bodiless(light)
    return compiler.result(compiler.surroundings(assets))
