"""A scene in plain numbers for renderers that run in an environment of their own: dictionaries, lists and .npz files.

Covers what the scenes of scenes.py are made of: pinhole and thin-lens cameras; spheres, quads and meshes, at rest or moved
along a line while the shutter is open; diffuse, rough metal without Fresnel, rough glass; emitting quads and spheres; a
constant environment. World frame: right-handed, y up; lengths in scene units; radiance linear RGB. Anything else raises
UnsupportedError.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.assets import Assets
from penumbra_kernels.compile.transforms import matrix_at
from penumbra_scene.materials import TextureRef
from penumbra_scene.scene import Scene
from scenes import UnsupportedError

Json = dict[str, Any]


def _material(material: Any, textures: Any) -> Json:
    """{'type': 'diffuse', 'color'} or {... 'checker': [color0, color1, scale]}, {'type': 'metal', 'color', 'alpha'},
    {'type': 'glass', 'ior', 'alpha'}; alpha is GGX's."""
    kind = material.type
    if kind == "diffuse":
        if not isinstance(material.base_color, TextureRef):
            return {"type": "diffuse", "color": list(material.base_color)}
        texture = textures[material.base_color.texture]
        if texture.type != "checker" or any(texture.uv.offset) or texture.uv.scale[0] != texture.uv.scale[1]:
            raise UnsupportedError(f"texture {texture.type} as given")
        checker = [list(texture.color0), list(texture.color1), texture.uv.scale[0]]
        return {"type": "diffuse", "checker": checker}
    single = not getattr(material, "energy_compensation", True) and not material.anisotropy
    if kind == "conductor" and single and not material.fresnel and material.roughness > 0:
        return {"type": "metal", "color": list(material.base_color), "alpha": material.roughness**2}
    if kind == "dielectric" and single and material.roughness > 0 and material.color == (1.0, 1.0, 1.0):
        return {"type": "glass", "ior": material.ior, "alpha": material.roughness**2}
    raise UnsupportedError(f"material {kind} as given")


def _moved(shape: Any) -> tuple[NDArray[np.float64], list[float]]:
    """Matrix at shutter time 0, and how far the shape has moved along a line at time 1."""
    start, end = (np.asarray(matrix_at(shape.transform, t), np.float64) for t in (0.0, 1.0))
    if not np.allclose(start[:3, :3], end[:3, :3], rtol=0, atol=1e-12):
        raise UnsupportedError("motion other than along a line")
    return start, [float(x) for x in end[:3, 3] - start[:3, 3]]


def _geometry(shape: Any, world: NDArray[np.float64], assets: Assets, file: Path) -> Json:
    def placed(point: Any) -> list[float]:
        return [float(x) for x in world[:3, :3] @ np.asarray(point, np.float64) + world[:3, 3]]

    if shape.type == "sphere":
        if not np.allclose(world[:3, :3], np.eye(3)):
            raise UnsupportedError("spheres that are turned or scaled")
        return {"type": "sphere", "center": placed(shape.center), "radius": shape.radius}
    if shape.type == "quad":
        edges = [[float(x) for x in world[:3, :3] @ np.asarray(e, np.float64)] for e in (shape.u, shape.v)]
        return {"type": "quad", "origin": placed(shape.origin), "u": edges[0], "v": edges[1]}
    if shape.type == "mesh":
        data = assets.mesh(shape.source) if shape.source is not None else shape
        if data.normals is not None or getattr(shape, "smooth", False):
            raise UnsupportedError("meshes other than flat ones")
        points = np.asarray(data.positions, np.float64) @ world[:3, :3].T + world[:3, 3]
        np.savez(file, positions=points.astype(np.float32), indices=np.asarray(data.indices, np.int32))
        return {"type": "mesh", "file": str(file)}
    raise UnsupportedError(f"shape {shape.type}")


def _shape(shape: Any, scene: Scene, assets: Assets, file: Path) -> Json:
    world, motion = _moved(shape)
    emission = getattr(shape, "emission", None)
    if emission is not None and (emission.two_sided or isinstance(emission.radiance, TextureRef)):
        raise UnsupportedError("emission on two sides or with a texture")
    if emission is not None and shape.material:
        raise UnsupportedError("lamps that reflect")
    return _geometry(shape, world, assets, file) | {
        "motion": motion,
        "material": shape.material,
        "radiance": list(emission.radiance) if emission is not None else None,
    }


def _camera(scene: Scene) -> Json:
    camera, film = scene.camera, scene.film
    if camera.type != "perspective" or film.filter.type != "box" or film.filter.radius != 0.5:
        raise UnsupportedError("cameras other than perspective, filters other than the pixel's box")
    if film.width != film.height or camera.lens.blades:
        raise UnsupportedError("films other than square, aperture blades")
    return {
        "matrix": np.asarray(matrix_at(camera.transform, 0.0), np.float64).tolist(),
        "fov": camera.fov,
        "size": film.width,
        "aperture": camera.lens.aperture_radius,
        "focus": camera.lens.focus_distance,
        "moves": camera.shutter.close > camera.shutter.open,
    }


def plain_scene(scene: Scene, assets: Assets, folder: Path) -> Json:
    """The scene; meshes go into `folder`. Keys: camera, materials, shapes, environment (radiance or None), max_bounces."""
    environment = scene.environment
    if scene.lights or (environment is not None and environment.type != "constant"):
        raise UnsupportedError("lights without extent, image environments")
    return {
        "camera": _camera(scene),
        "materials": {k: _material(m, scene.textures) for k, m in scene.materials.items()},
        "shapes": [_shape(shape, scene, assets, folder / f"{i}.npz") for i, shape in enumerate(scene.shapes)],
        "environment": list(environment.radiance) if environment is not None else None,
        "max_bounces": scene.integrator.max_bounces,
    }
