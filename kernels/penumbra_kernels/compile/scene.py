"""Scene model -> everything a device needs: arrays, launch parameters, features. Knows no device.

Lengths are metres relative to the anchor, subtracted in float64, so that a scene far from its origin keeps its precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene

from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.assets import Assets
from penumbra_kernels.compile.camera import compile_camera
from penumbra_kernels.compile.filters import compile_filter
from penumbra_kernels.compile.geometry import compile_geometry
from penumbra_kernels.compile.lights import compile_lights
from penumbra_kernels.compile.materials import compile_albedo_table, compile_materials
from penumbra_kernels.compile.textures import compile_textures
from penumbra_kernels.compile.together import together
from penumbra_kernels.compile.transforms import matrix_at
from penumbra_kernels.features import Features, analyse
from penumbra_kernels.layout import CONSTANTS, PARAMS
from penumbra_kernels.reach import stripped


@dataclass(frozen=True)
class CompiledScene:
    """One frame, ready for any device."""

    arrays: dict[str, NDArray[Any]]
    """Buffers by the name of trace.cl's argument."""
    params: NDArray[Any]
    """One PARAMS record; tile, samples and replicates are filled in per launch."""
    features: Features
    triangle_count: int
    light_count: int

    @property
    def bytes(self) -> int:
        """Scene data on the device, in bytes."""
        return sum(array.nbytes for array in self.arrays.values())


def anchor_of(scene: Scene, time: float) -> NDArray[np.float64]:
    """The point that lengths are relative to: where the camera stands at its first keyframe."""
    transform = scene.camera.transform
    start = transform.keyframes[0].time if not isinstance(transform, tuple) else time
    return np.asarray(matrix_at(transform, start)[:3, 3], np.float64)


def compile_scene(
    scene: Scene, assets: Assets, time: float = 0.0, trees: Trees | None = None
) -> CompiledScene:
    """Turn the frame at `time` seconds into arrays. Raises AssetError for assets that are missing or broken.

    trees: kept by whoever compiles several frames, so that trees over what does not move are built once.
    """
    features = analyse(scene, time)
    scene = stripped(scene)
    anchor = anchor_of(scene, time)
    textures, texels, texture_index = compile_textures(scene, assets)
    materials, material_index = compile_materials(scene, texture_index)
    geometry = compile_geometry(scene, assets, time, anchor, material_index, trees)
    lights = compile_lights(scene, geometry, time, anchor, assets)
    camera, camera_keyframes, shutter_table = compile_camera(scene.camera, scene.film, time, anchor)
    camera["first_keyframe"] = len(geometry.keyframes) + len(lights.keyframes)
    arrays = {
        **geometry.arrays,
        **lights.arrays,
        "filter_table": compile_filter(scene.film.filter),
        "shutter_table": shutter_table,
        "keyframes": np.concatenate([geometry.keyframes, lights.keyframes, camera_keyframes]),
        "materials": materials,
        "albedo_table": compile_albedo_table(materials),
        "textures": textures,
        "texels": texels,
    }
    params = _params(scene)
    params["camera"] = camera
    if "indirect" not in features:
        # The generic program, too, traces no ray that can find no light.
        params["max_bounces"] = 0
    params["root"] = geometry.root
    params["plane_count"] = geometry.plane_count
    params["light_count"] = lights.light_count
    params["options"] |= CONSTANTS["OPTION_LIGHT_TREE"] if "light_tree" in features else 0
    if "area_lights" in features or "environment" in features:
        params["options"] |= CONSTANTS["OPTION_LIGHTS_TO_MEET"]
    params["options"] |= together(geometry.arrays)
    params["environment_light"] = lights.environment_light
    return CompiledScene(arrays, params, features, geometry.triangle_count, lights.light_count)


def _params(scene: Scene) -> NDArray[Any]:
    params = np.zeros((), PARAMS)
    integrator = scene.integrator
    params["seed"] = scene.sampler.seed
    params["film_width"] = scene.film.width
    params["film_height"] = scene.film.height
    params["filter_radius"] = scene.film.filter.radius
    params["max_bounces"] = integrator.max_bounces
    params["roulette_start"] = integrator.roulette_start
    params["shadow_rays"] = integrator.shadow_rays
    options = 0
    if integrator.light_selection == "all":
        options |= CONSTANTS["OPTION_ALL_LIGHTS"]
    if not integrator.mis:
        options |= CONSTANTS["OPTION_NO_MIS"]
    params["options"] = options
    return params
