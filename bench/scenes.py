"""The scenes that renderers are measured on: small, and made of what all of them define alike. 128 x 128 pixels."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from meshes import knot
from penumbra_kernels.assets import Image, MeshData, NoAssets
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene

Json = dict[str, Any]
SIZE = 128


class UnsupportedError(ValueError):
    """The scene has something that the two renderers do not define alike."""


class HeldMeshes:
    """Assets in memory, by the hash of their positions."""

    def __init__(self) -> None:
        self.held: dict[str, MeshData] = {}

    def add(self, positions: Any, indices: Any) -> Json:
        """Keeps a mesh; the `source` that names it."""
        name = "sha256:" + hashlib.sha256(np.ascontiguousarray(positions)).hexdigest()
        self.held[name] = MeshData(np.asarray(positions, np.float64), indices, None, None)
        return {"asset": name}

    def mesh(self, ref: AssetRef) -> MeshData:
        return self.held[ref.asset]

    def image(self, ref: AssetRef) -> Image:
        return NoAssets().image(ref)


def _scene(shapes: list[Json], origin: Any, target: Any, fov: float = 40.0, **more: Any) -> Json:
    camera = {
        "type": "perspective",
        "fov": fov,
        "transform": {"look_at": {"origin": list(origin), "target": list(target)}},
    }
    camera |= more.pop("camera", {})
    integrator = {"max_bounces": 4, "roulette_start": 1000} | more.pop("integrator", {})
    film = {"width": SIZE, "height": SIZE, "filter": {"type": "box", "radius": 0.5}}
    return {"version": 1, "camera": camera, "film": film, "integrator": integrator, "shapes": shapes, **more}


def _quad(origin: Any, u: Any, v: Any, **more: Any) -> Json:
    return {"type": "quad", "origin": list(origin), "u": list(u), "v": list(v), **more}


def _ball(center: Any, radius: float, material: str, **more: Any) -> Json:
    return {"type": "sphere", "center": list(center), "radius": radius, "material": material, **more}


def _ground(material: str, reach: float = 20.0) -> Json:
    return _quad((-reach, 0, reach), (2 * reach, 0, 0), (0, 0, -2 * reach), material=material)


def _lamp(side: float, height: float, radiance: float, x: float = 0.0, z: float = 0.0) -> Json:
    """A square lamp that shines down."""
    h = side / 2
    return _quad((x - h, height, z - h), (side, 0, 0), (0, 0, side), emission={"radiance": radiance})


DIFFUSE: Json = {
    "white": {"type": "diffuse", "base_color": [0.73, 0.73, 0.73]},
    "red": {"type": "diffuse", "base_color": [0.63, 0.065, 0.05]},
    "green": {"type": "diffuse", "base_color": [0.14, 0.45, 0.091]},
}


def cornell(held: HeldMeshes) -> Json:
    """36 triangles, diffuse, one lamp, paths of up to 6 vertices."""
    from meshes import box

    walls = [
        _quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), material="white"),
        _quad((-1, 2, -1), (2, 0, 0), (0, 0, 2), material="white"),
        _quad((-1, 0, -1), (2, 0, 0), (0, 2, 0), material="white"),
        _quad((-1, 0, 1), (0, 0, -2), (0, 2, 0), material="red"),
        _quad((1, 0, -1), (0, 0, 2), (0, 2, 0), material="green"),
    ]
    blocks = [
        {"type": "mesh", "positions": p.tolist(), "indices": i.tolist(), "material": "white"}
        for p, i in (
            box(np.array([-0.65, 0.0, -0.6]), np.array([-0.05, 1.2, 0.0]), 0.3),
            box(np.array([0.05, 0.0, -0.1]), np.array([0.65, 0.6, 0.5]), -0.3),
        )
    ]
    lamp = _lamp(0.5, 1.99, 17.0)
    return _scene([*walls, *blocks, lamp], (0, 1, 3.9), (0, 1, 0), 37.9, materials=DIFFUSE)


def horizon(held: HeldMeshes) -> Json:
    """A checkerboard of 4 km, three spheres, a small lamp and a sky."""
    board = {"type": "checker", "color0": 0.8, "color1": 0.1, "uv": {"scale": [2000, 2000]}}
    materials = DIFFUSE | {"board": {"type": "diffuse", "base_color": {"texture": "board"}}}
    balls = [_ball((x, 0.6, 0), 0.6, m) for x, m in ((-1.5, "red"), (0, "white"), (1.5, "green"))]
    return _scene(
        [_ground("board", 2000.0), *balls, _lamp(0.3, 4.0, 90.0)],
        (0, 1.6, 6), (0, 0.9, 0),
        materials=materials, textures={"board": board}, environment={"type": "constant", "radiance": 0.3},
    )  # fmt: skip


def gloss(held: HeldMeshes) -> Json:
    """Four metal plates from smooth to rough under spherical lamps of four sizes (Veach 1997, figure 9.2)."""
    shapes: list[Json] = [_ground("white"), _quad((-8, 0, -2.5), (16, 0, 0), (0, 8, 0), material="white")]
    materials = dict(DIFFUSE)
    for i, (roughness, height) in enumerate(((0.08, 1.5), (0.2, 1.0), (0.35, 0.6), (0.5, 0.3))):
        materials[f"m{i}"] = {
            "type": "conductor", "base_color": [0.9, 0.85, 0.8], "roughness": roughness,
            "fresnel": False, "energy_compensation": False,
        }  # fmt: skip
        z = -1.5 + i * 0.8
        shapes.append(_quad((-2, height, z + 0.5), (4, 0, 0), (0, 0.35 - 0.06 * i, -0.55), material=f"m{i}"))
    for i, radius in enumerate((0.03, 0.1, 0.25, 0.5)):
        shapes.append(
            {
                "type": "sphere",
                "center": [-1.8 + 1.2 * i, 3.2, -1.5],
                "radius": radius,
                "emission": {"radiance": 1.0 / radius**2},
            }
        )
    return _scene(shapes, (0, 2.0, 7.5), (0, 1.3, 0), 38.0, materials=materials)


def lens(held: HeldMeshes) -> Json:
    """Spheres at several distances before a thin lens, under a sky."""
    balls = [
        _ball((-2 + i, 0.5, 2 - 1.2 * i), 0.5, m) for i, m in enumerate(("red", "white", "green", "white"))
    ]
    return _scene(
        [_ground("white"), *balls], (0, 1.4, 6), (0, 0.5, 0),
        camera={"lens": {"aperture_radius": 0.15, "focus_distance": 6.0}},
        materials=DIFFUSE, environment={"type": "constant", "radiance": 0.9},
    )  # fmt: skip


def glass(held: HeldMeshes) -> Json:
    """A rough glass slab before diffuse spheres, paths of up to 10 vertices."""
    from meshes import box

    materials = DIFFUSE | {
        "glass": {"type": "dielectric", "ior": 1.5, "roughness": 0.3, "energy_compensation": False}
    }
    p, i = box(np.array([-1.2, 0.05, 1.0]), np.array([1.2, 1.8, 1.3]))
    slab = {"type": "mesh", "positions": p.tolist(), "indices": i.tolist(), "material": "glass"}
    balls = [_ball((x, 0.6, -0.3), 0.6, m) for x, m in ((-0.8, "red"), (0.8, "green"))]
    back = _quad((-6, 0, -2), (12, 0, 0), (0, 6, 0), material="white")
    return _scene(
        [_ground("white"), back, slab, *balls, _lamp(1.0, 4.0, 16.0, z=1.0)], (0, 1.2, 5.5), (0, 0.9, 0),
        integrator={"max_bounces": 8}, materials=materials,
    )  # fmt: skip


def lights(held: HeldMeshes, count: int = 200) -> Json:
    """A room with small lamps of very different power, and pillars between them."""
    rng = np.random.default_rng(11)
    shapes = [
        _quad((-5, 0, 5), (10, 0, 0), (0, 0, -10), material="white"),
        _quad((-5, 3, -5), (10, 0, 0), (0, 0, 10), material="white"),
        _quad((-5, 0, -5), (10, 0, 0), (0, 3, 0), material="white"),
        _quad((-5, 0, 5), (0, 0, -10), (0, 3, 0), material="red"),
        _quad((5, 0, -5), (0, 0, 10), (0, 3, 0), material="green"),
        *(_ball((x, 0.8, z), 0.5, "white") for x in (-3, 0, 3) for z in (-3, 0, 3)),
    ]
    for x, z, power in zip(
        rng.uniform(-4.8, 4.8, count),
        rng.uniform(-4.8, 4.8, count),
        rng.lognormal(0, 1.2, count),
        strict=True,
    ):
        shapes.append(_lamp(0.06, 2.9, round(6.0 * power, 4), round(x, 4), round(z, 4)))
    return _scene(shapes, (0, 1.7, 4.9), (0, 1.2, 0), 60.0, integrator={"max_bounces": 2}, materials=DIFFUSE)


def mesh(held: HeldMeshes, triangles: int = 1_000_000) -> Json:
    """A rippled knot of a million triangles on a ground, under a sky."""
    positions, indices = knot(triangles)
    shape = {
        "type": "mesh",
        "source": held.add(positions + np.float32([0, 0.4, 0]), indices),
        "material": "red",
    }
    return _scene(
        [_ground("white"), shape], (0, 1.6, 2.6), (0, 0.35, 0),
        materials=DIFFUSE, environment={"type": "constant", "radiance": 0.9},
    )  # fmt: skip


def motion(held: HeldMeshes) -> Json:
    """Three spheres that move while the shutter is open, under a sky."""
    balls = []
    for x, material in ((-1.3, "red"), (0, "white"), (1.3, "green")):
        keyframes = [
            {"time": 0, "transform": []},
            {"time": 1, "transform": [{"translate": [0.5, 0.2 * abs(x), 0.3]}]},
        ]
        balls.append(_ball((x, 0.6, 0), 0.5, material, transform={"keyframes": keyframes}))
    return _scene(
        [_ground("white"), *balls], (0, 1.4, 5.5), (0, 0.6, 0),
        camera={"shutter": {"open": 0.0, "close": 1.0}},
        materials=DIFFUSE, environment={"type": "constant", "radiance": 0.9},
    )  # fmt: skip


SCENES: dict[str, Callable[[HeldMeshes], Json]] = {
    f.__name__: f for f in (cornell, horizon, gloss, lens, glass, lights, mesh, motion)
}


def build(name: str, sampler: str = "sobol", seed: int = 1) -> tuple[Scene, HeldMeshes]:
    """A scene by its name, and the meshes that it names."""
    held = HeldMeshes()
    data = SCENES[name](held)
    data["sampler"] = {"type": sampler, "seed": seed}
    return Scene.model_validate(data), held
