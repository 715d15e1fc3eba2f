"""A plain scene in LuxCore: path tracing on the CPU (PATHCPU, on Embree) with Sobol numbers and what makes it comparable.

Off: roulette, clamping, adaptive sampling, the film's pipeline. LuxCore has no spheres, which are fine flat meshes here, and
no GGX: metal and rough glass are unsupported.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pyluxcore

pyluxcore.Init()
VERSION = pyluxcore.Version()
ROULETTE_OFF = 1024
FINENESS = 6
"""Times that a sphere's octahedron is divided: 32,768 triangles, whose radius is true to 3e-4."""
Render = Callable[[int, int], tuple[float, Any]]
Properties = dict[str, Any]


def _octasphere() -> tuple[Any, Any]:
    """A unit sphere of triangles about as large as one another, and of the sphere's mean radius."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(FINENESS):
        a, b, c = (points[faces[:, k]] for k in range(3))
        corners = np.stack([a, b, c, a + b, b + c, c + a], axis=1)
        points = (corners / np.linalg.norm(corners, axis=2, keepdims=True)).reshape(-1, 3)
        parts = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
        faces = (np.arange(len(faces))[:, None, None] * 6 + parts).reshape(-1, 3)
    corners = points[faces]
    inner = np.linalg.norm(corners.mean(axis=1), axis=1).mean()
    return points * (2.0 / (1.0 + inner)), faces


def _mesh(shape: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Positions, indices, texture coordinates or None."""
    if shape["type"] == "sphere":
        points, faces = _octasphere()
        return np.array(shape["center"]) + shape["radius"] * points, faces, None
    if shape["type"] == "quad":
        o, u, v = (np.array(shape[key]) for key in ("origin", "u", "v"))
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        return o + corners[:, :1] * u + corners[:, 1:] * v, np.array([[0, 1, 2], [0, 2, 3]]), corners
    stored = np.load(shape["file"])
    return stored["positions"], stored["indices"], None


def _material(name: str, given: dict[str, Any]) -> Properties:
    if given["type"] != "diffuse":
        raise NotImplementedError(f"{given['type']} with GGX microfacets")
    at = f"scene.materials.{name}"
    if "checker" not in given:
        return {f"{at}.type": "matte", f"{at}.kd": given["color"]}
    color0, color1, scale = given["checker"]
    texture = f"scene.textures.{name}_checker"
    return {
        f"{texture}.type": "checkerboard2d",
        f"{texture}.texture1": color0,
        f"{texture}.texture2": color1,
        f"{texture}.mapping.type": "uvmapping2d",
        f"{texture}.mapping.uvscale": [2.0 * scale, 2.0 * scale],
        f"{at}.type": "matte",
        f"{at}.kd": f"{name}_checker",
    }


def _motion(at: str, motion: list[float]) -> Properties:
    properties: Properties = {}
    for i, share in enumerate((0.0, 1.0)):
        matrix = np.eye(4)
        matrix[:3, 3] = share * np.array(motion)
        properties[f"{at}.motion.{i}.time"] = share
        properties[f"{at}.motion.{i}.transformation"] = matrix.T.ravel().tolist()
    return properties


def _shape(scene: Any, i: int, shape: dict[str, Any]) -> Properties:
    positions, indices, uvs = _mesh(shape)
    triangles = [tuple(int(k) for k in face) for face in indices]
    points = [tuple(float(x) for x in p) for p in positions]
    coordinates = None if uvs is None else [tuple(float(x) for x in p) for p in uvs]
    scene.DefineMesh(f"mesh{i}", points, triangles, None, coordinates, None, None)
    at = f"scene.objects.object{i}"
    properties: Properties = {f"{at}.shape": f"mesh{i}", f"{at}.material": shape["material"] or f"lamp{i}"}
    if shape["radiance"]:
        lamp = f"scene.materials.lamp{i}"
        properties |= {
            f"{lamp}.type": "matte",
            f"{lamp}.kd": [0.0] * 3,
            f"{lamp}.emission": shape["radiance"],
        }
    if any(shape["motion"]):
        properties |= _motion(at, shape["motion"])
    return properties


def _camera(camera: dict[str, Any]) -> Properties:
    matrix = np.array(camera["matrix"])
    eye = matrix[:3, 3]
    pixel = 2.0 / camera["size"]
    at = "scene.camera"
    properties: Properties = {
        f"{at}.type": "perspective",
        f"{at}.lookat.orig": eye.tolist(),
        f"{at}.lookat.target": (eye - matrix[:3, 2]).tolist(),
        f"{at}.up": matrix[:3, 1].tolist(),
        f"{at}.fieldofview": camera["fov"],
        f"{at}.screenwindow": [
            -1.0,
            1.0,
            -1.0 - pixel,
            1.0 - pixel,
        ],  # its first row lies one above the window
        f"{at}.autofocus.enable": False,
        f"{at}.cliphither": 1e-4,
        f"{at}.clipyon": 1e6,
        f"{at}.shutteropen": 0.0,
        f"{at}.shutterclose": 1.0 if camera["moves"] else 0.0,
    }
    if camera["aperture"]:
        properties |= {f"{at}.lensradius": camera["aperture"], f"{at}.focaldistance": camera["focus"]}
    return properties


def _set(properties: Properties) -> Any:
    result = pyluxcore.Properties()
    for name, value in properties.items():
        result.Set(pyluxcore.Property(name, value))
    return result


def _scene(plain: dict[str, Any]) -> Any:
    scene = pyluxcore.Scene()
    properties = _camera(plain["camera"])
    for name, given in plain["materials"].items():
        properties |= _material(name, given)
    for i, shape in enumerate(plain["shapes"]):
        properties |= _shape(scene, i, shape)
    if plain["environment"]:
        properties |= {
            "scene.lights.sky.type": "constantinfinite",
            "scene.lights.sky.color": plain["environment"],
        }
    scene.Parse(_set(properties))
    return scene


def _config(plain: dict[str, Any], samples: int, seed: int) -> Properties:
    depth = plain["max_bounces"] + 2
    size = plain["camera"]["size"]
    return {
        "renderengine.type": "PATHCPU",
        "renderengine.seed": seed,
        "native.threads.count": 1,
        "sampler.type": "SOBOL",
        "sampler.sobol.adaptive.strength": 0.0,
        "lightstrategy.type": "LOG_POWER",
        "path.pathdepth.total": depth,
        "path.pathdepth.diffuse": depth,
        "path.pathdepth.glossy": depth,
        "path.pathdepth.specular": depth,
        "path.russianroulette.depth": ROULETTE_OFF,
        "path.clamping.variance.maxvalue": 0.0,
        "film.width": size,
        "film.height": size,
        "film.filter.type": "NONE",
        "film.imagepipelines.0.0.type": "NOP",
        "film.outputs.0.type": "RGB",
        "film.outputs.0.filename": "unused.exr",
        "film.outputs.0.index": 0,
        "batch.haltspp": [samples, 0],
    }


def load(plain: dict[str, Any]) -> Render:
    """Parses the scene once; each picture is a session of its own."""
    scene = _scene(plain)
    size = plain["camera"]["size"]

    def render(samples: int, seed: int) -> tuple[float, Any]:
        session = pyluxcore.RenderSession(pyluxcore.RenderConfig(_set(_config(plain, samples, seed)), scene))
        session.Start()
        while not session.HasDone():
            time.sleep(0.005)
            session.UpdateStats()
        session.UpdateStats()
        taken = session.GetStats().Get("stats.renderengine.total.samplecount").GetFloat() / size**2
        pixels = np.zeros(size * size * 3, np.float32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, pixels, 0, True)
        session.Stop()
        return taken, pixels.reshape(size, size, 3)[::-1]

    return render
