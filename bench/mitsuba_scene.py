"""Penumbra scene JSON -> Mitsuba 3 dictionary, for side-by-side measurements. Bench-only: needs `pip install mitsuba`.

Covers what both renderers define alike: perspective cameras, box filters, diffuse, mirrors, conductors without Fresnel
and without energy compensation, smooth and rough dielectrics, thin panes, quads, discs, spheres, inline meshes, area,
point and directional lights, constant environments, checkers, meshes of assets. Anything else raises UnsupportedError
with its name.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from penumbra_kernels.assets import Assets, NoAssets
from penumbra_kernels.compile.transforms import matrix_at
from penumbra_scene.materials import TextureRef
from penumbra_scene.scene import Scene
from scenes import UnsupportedError


def _transform(matrix: np.ndarray) -> Any:
    return mi.ScalarTransform4f(np.asarray(matrix, np.float64).tolist())


def _rgb(value: Any) -> dict[str, Any]:
    if isinstance(value, TextureRef):
        raise UnsupportedError("textures other than a diffuse surface's")
    return {"type": "rgb", "value": list(value)}


def _reflectance(value: Any, textures: Any) -> dict[str, Any]:
    if not isinstance(value, TextureRef):
        return _rgb(value)
    texture = textures[value.texture]
    if texture.type != "checker" or any(texture.uv.offset):
        raise UnsupportedError(f"texture {texture.type} as given")
    matrix = np.diag([*texture.uv.scale, 1.0, 1.0])
    return {
        "type": "checkerboard",
        "color0": _rgb(texture.color0),
        "color1": _rgb(texture.color1),
        "to_uv": _transform(matrix),
    }


def _bsdf(material: Any, textures: Any) -> dict[str, Any]:
    kind = material.type
    if kind == "diffuse":
        return {
            "type": "twosided",
            "b": {"type": "diffuse", "reflectance": _reflectance(material.base_color, textures)},
        }
    if kind == "mirror":
        return {
            "type": "twosided",
            "b": {"type": "conductor", "material": "none", "specular_reflectance": _rgb(material.color)},
        }
    if (
        kind == "conductor"
        and not material.fresnel
        and not material.energy_compensation
        and not material.anisotropy
    ):
        color = _rgb(material.base_color)
        if material.roughness == 0:
            inner: dict[str, Any] = {"type": "conductor", "material": "none", "specular_reflectance": color}
        else:
            inner = {
                "type": "roughconductor",
                "material": "none",
                "distribution": "ggx",
                "alpha": material.roughness**2,
                "specular_reflectance": color,
            }
        return {"type": "twosided", "b": inner}
    if kind == "dielectric" and not material.anisotropy and material.color == (1.0, 1.0, 1.0):
        if material.roughness == 0:
            return {"type": "dielectric", "int_ior": material.ior, "ext_ior": 1.0}
        if not material.energy_compensation:
            return {
                "type": "roughdielectric",
                "distribution": "ggx",
                "alpha": material.roughness**2,
                "int_ior": material.ior,
                "ext_ior": 1.0,
            }
    if kind == "thin_dielectric" and material.roughness == 0:
        return {"type": "thindielectric", "int_ior": material.ior, "ext_ior": 1.0}
    raise UnsupportedError(f"material {kind} as given")


def _quad_matrix(shape: Any) -> np.ndarray:
    origin, u, v = (np.array(x, np.float64) for x in (shape.origin, shape.u, shape.v))
    matrix = np.eye(4)
    n = np.cross(u, v)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = u / 2, v / 2, n / np.linalg.norm(n)
    matrix[:3, 3] = origin + u / 2 + v / 2
    return matrix


def _disc_matrix(shape: Any) -> np.ndarray:
    n = np.array(shape.normal, np.float64)
    n /= np.linalg.norm(n)
    s = np.cross(n, [0, 1, 0] if abs(n[1]) < 0.9 else [1, 0, 0])
    s /= np.linalg.norm(s)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = s * shape.radius, np.cross(n, s) * shape.radius, n
    matrix[:3, 3] = shape.center
    return matrix


def _mesh(shape: Any, world: np.ndarray, properties: dict[str, Any], assets: Assets) -> Any:
    data = assets.mesh(shape.source) if shape.source is not None else shape
    if data.normals is not None or shape.smooth:
        raise UnsupportedError("meshes other than flat ones")
    props = mi.Properties()
    for key, value in properties.items():
        props[key] = mi.load_dict(value)
    mesh = mi.Mesh("mesh", len(data.positions), len(data.indices), props=props)
    points = np.asarray(data.positions, np.float64) @ world[:3, :3].T + world[:3, 3]
    params = mi.traverse(mesh)
    params["vertex_positions"] = points.astype(np.float32).ravel()
    params["faces"] = np.asarray(data.indices, np.uint32).ravel()
    params.update()
    return mesh


def _shape(shape: Any, scene: Scene, assets: Assets) -> Any:
    if shape.type == "instance" or not isinstance(shape.transform, tuple):
        raise UnsupportedError("instances and motion")
    world = np.asarray(matrix_at(shape.transform, 0.0), np.float64)
    default = {
        "type": "diffuse",
        "reflectance": {"type": "rgb", "value": 0.8 if not getattr(shape, "emission", None) else 0.0},
    }
    properties: dict[str, Any] = {
        "bsdf": _bsdf(scene.materials[shape.material], scene.textures) if shape.material else default
    }
    if getattr(shape, "emission", None):
        if shape.emission.two_sided:
            raise UnsupportedError("two-sided emission")
        properties["emitter"] = {"type": "area", "radiance": _rgb(shape.emission.radiance)}
    if shape.type == "sphere":
        local = np.eye(4)
        local[:3, :3] *= shape.radius
        local[:3, 3] = shape.center
        return {"type": "sphere", "to_world": _transform(world @ local), **properties}
    if shape.type == "quad":
        return {"type": "rectangle", "to_world": _transform(world @ _quad_matrix(shape)), **properties}
    if shape.type == "disc":
        return {"type": "disk", "to_world": _transform(world @ _disc_matrix(shape)), **properties}
    if shape.type == "mesh":
        return _mesh(shape, world, properties, assets)
    raise UnsupportedError(f"shape {shape.type}")


def _light(light: Any) -> dict[str, Any]:
    world = np.asarray(matrix_at(light.transform, 0.0), np.float64)
    if light.type == "point":
        position = world[:3, :3] @ np.array(light.position) + world[:3, 3]
        return {"type": "point", "position": position.tolist(), "intensity": _rgb(light.intensity)}
    if light.type == "directional":
        return {
            "type": "directional",
            "direction": (world[:3, :3] @ np.array(light.direction)).tolist(),
            "irradiance": _rgb(light.irradiance),
        }
    raise UnsupportedError(f"light {light.type}")


def to_mitsuba(scene: Scene, sampler: str = "independent", assets: Assets | None = None) -> dict[str, Any]:
    """The same scene as a dictionary for mitsuba.load_dict (a variant must be set)."""
    camera, film = scene.camera, scene.film
    if camera.type != "perspective" or film.filter.type != "box" or film.filter.radius != 0.5 or film.crop:
        raise UnsupportedError("cameras other than perspective, filters other than the pixel's box, crops")
    flip = np.diag([-1.0, 1.0, -1.0, 1.0])
    sensor: dict[str, Any] = {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": camera.fov_axis,
        "near_clip": 1e-4,
        "far_clip": 1e6,
        "to_world": _transform(np.asarray(matrix_at(camera.transform, 0.0)) @ flip),
        "film": {
            "type": "hdrfilm",
            "width": film.width,
            "height": film.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": sampler, "sample_count": 64},
    }
    if camera.lens.aperture_radius:
        if camera.lens.blades:
            raise UnsupportedError("aperture blades")
        sensor |= {
            "type": "thinlens",
            "aperture_radius": camera.lens.aperture_radius,
            "focus_distance": camera.lens.focus_distance,
        }
    depth = scene.integrator.max_bounces + 2
    result: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth, "rr_depth": 1000},
        "sensor": sensor,
    }
    for i, shape in enumerate(scene.shapes):
        result[f"shape{i}"] = _shape(shape, scene, assets or NoAssets())
    for i, light in enumerate(scene.lights):
        result[f"light{i}"] = _light(light)
    if scene.environment is not None:
        if scene.environment.type != "constant":
            raise UnsupportedError("image environments")
        result["environment"] = {"type": "constant", "radiance": _rgb(scene.environment.radiance)}
    return result
