"""Hard cases 33-35: furnaces, and light that no path can find."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from penumbra_scene.scene import Scene

from penumbra_kernels.hardcases.benches.pictures import Renderer
from penumbra_kernels.hardcases.case import HardCase, Measure, Workbench, Z, at_least, at_most, hard_case
from penumbra_kernels.limits import not_covered

WHITE: Final[tuple[dict[str, Any], ...]] = (
    {"type": "diffuse", "base_color": 1},
    {"type": "mirror"},
    {"type": "conductor", "base_color": 1, "roughness": 0},
    {"type": "dielectric", "roughness": 0},
    {"type": "thin_dielectric"},
    {"type": "diffuse_transmission", "reflectance": 0.25, "transmittance": 0.75},
)


def furnace(material: dict[str, Any], **keys: Any) -> dict[str, Any]:
    """A sphere in an environment of radiance 1."""
    return {
        "camera": {"type": "perspective", "fov": 40, "transform": {"translate": [0, 0, 4]}},
        "film": {"width": 16, "height": 16},
        "materials": {"m": material},
        "shapes": [{"type": "sphere", "material": "m"}],
        "environment": {"type": "constant", "radiance": 1},
        "integrator": {"max_bounces": 64},
        **keys,
    }


@hard_case(
    33,
    "closed-sphere",
    "A camera in a closed sphere that emits 1 and reflects 99 % sees 100.",
    oracle="L = Le / (1 - albedo) = 100; a depth cut at 100 bounces would lose 36 %",
    algorithm="Russian roulette (Arvo and Kirk 1990) with survival min(1, throughput): capped below .99, variance is infinite",
)
def closed_sphere(bench: Workbench) -> Iterator[Measure]:
    sphere = {"type": "sphere", "radius": 2, "material": "m", "emission": {"radiance": 1, "two_sided": True}}
    scene = {
        "camera": {"type": "perspective", "fov": 60},
        "film": {"width": 8, "height": 8},
        "materials": {"m": {"type": "diffuse", "base_color": 0.99}},
        "shapes": [sphere],
        "integrator": {"max_bounces": 65535},
    }
    picture = bench.get(Renderer)(scene, samples=bench.count(256, 4096))
    yield at_most(f"|z| of the mean {picture.mean.mean():.2f}", abs(picture.z_of(100.0)), Z)
    error = np.sqrt(picture.variance.sum()) / picture.variance.size
    yield at_most("standard error of the mean", error, 2.5)


@hard_case(
    34,
    "white-furnace",
    "White things of every kind vanish in a white furnace.",
    oracle="1 +- 1e-4 beside the noise",
    algorithm="No material keeps or makes energy; sums are pairwise",
)
def white_furnace(bench: Workbench) -> Iterator[Measure]:
    for material in WHITE:
        picture = bench.get(Renderer)(furnace(material), samples=bench.count(64, 1024))
        noise = Z * np.sqrt(picture.variance.sum()) / picture.mean.size
        beyond = max(abs(picture.mean.mean() - 1) - noise, 0.0)
        yield at_most(f"|mean - 1| beyond its noise, {material['type']}", beyond, 1e-4)
        yield at_most(f"rejected samples, {material['type']}", picture.node.sums["rejected"].sum(), 0)


def _glass_globe(light: dict[str, Any], material: dict[str, Any]) -> Scene:
    shapes = [
        {"type": "disc", "center": [0, -2, 0], "normal": [0, 1, 0], "radius": 20, "material": "floor"},
        {"type": "sphere", "material": "globe"},
    ]
    materials = {"floor": {"type": "diffuse"}, "globe": material}
    camera = {"type": "perspective", "transform": {"translate": [0, 0, 6]}}
    return Scene.model_validate(
        {"version": 1, "camera": camera, "materials": materials, "shapes": shapes, **light}
    )


@hard_case(
    35,
    "caustic",
    "Light of a point or a tiny lamp inside glass reaches the floor by paths that cannot be found, or hardly ever.",
    oracle="the picture lacks that light: a floor around a point light in glass is black; the result says so",
    algorithm="Cannot pass, as paths start at the camera: `penumbra explain` and the receipt (not_covered) say so",
)
def caustic(bench: Workbench) -> Iterator[Measure]:
    point = {"lights": [{"type": "point", "intensity": 10}], "integrator": {"max_bounces": 32}}
    glass, paper = {"type": "dielectric"}, {"type": "diffuse_transmission"}
    lamp = [{"type": "sphere", "radius": 1e-3, "emission": {"radiance": 1e6}}]
    for name, scene in (
        ("a point light in glass", _glass_globe(point, glass)),
        (
            "a directional light on a mirror",
            _glass_globe({"lights": [{"type": "directional"}]}, {"type": "mirror"}),
        ),
        ("a tiny lamp in glass", _with(_glass_globe({}, glass), lamp)),
    ):
        told = [limit.name for limit in not_covered(scene)]
        yield at_least(f"statements about caustics, {name}", sum("caustics" in word for word in told), 1)
    plain = not_covered(_glass_globe(point, paper))
    yield at_most(
        "statements about caustics where nothing is smooth",
        sum("caustics" in limit.name for limit in plain),
        0,
    )
    picture = bench.get(Renderer)(_glass_globe(point, glass), samples=8, tile=None)
    yield at_most("light of the point light that was found, all of it caustic", picture.mean.max(), 0)


def _with(scene: Scene, shapes: list[dict[str, Any]]) -> Scene:
    document = scene.model_dump(mode="json", exclude_unset=True)
    return Scene.model_validate({**document, "shapes": [*document["shapes"], *shapes]})


CASES: Final[tuple[HardCase, ...]] = (closed_sphere, white_furnace, caustic)
