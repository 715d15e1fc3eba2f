"""Scenes that have just the effects that one names, for tests that go through all of them."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from penumbra_kernels.assets import Image, MeshData
from penumbra_kernels.features import EFFECTS
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene

WIDTH, HEIGHT = 12, 10

SHUTTER: Final = {"open": 0.0, "close": 0.5}
TOWARDS: Final = {"look_at": {"origin": [0, 1, 6], "target": [0, 1, 0]}}


def moving(*steps: dict[str, Any]) -> dict[str, Any]:
    """A transform that turns and shifts what `steps` place, over a second."""
    end = [{"translate": [0.6, 0.2, 0]}, {"rotate": {"axis": [0, 1, 0], "angle": 20}}]
    return {
        "keyframes": [
            {"time": 0, "transform": list(steps)},
            {"time": 1, "transform": [*end, *steps]},
        ]
    }


def quad(x: float, material: str | None = None, **keys: Any) -> dict[str, Any]:
    """A square of side 1 that faces the camera, its left edge at x."""
    shape = {"type": "quad", "origin": [x, 0.2, 0.5], "u": [1, 0, 0], "v": [0, 1, 0], **keys}
    return shape if material is None else {**shape, "material": material}


TRIANGLE: Final = [[-0.4, 1.5, 0.5], [0.5, 1.4, 0.5], [0.1, 2.1, 0.7]]

PARTS: Final[dict[str, dict[str, Any]]] = {
    "lens": {"camera": {"lens": {"aperture_radius": 0.08, "focus_distance": 5, "blades": 5}}},
    "camera_motion": {"camera": {"transform": moving(TOWARDS), "shutter": SHUTTER}},
    "motion": {"camera": {"shutter": SHUTTER}, "shapes": [quad(-0.5, transform=moving())]},
    "deformation": {
        "camera": {"shutter": SHUTTER},
        "shapes": [
            {
                "type": "mesh",
                "positions": TRIANGLE,
                "indices": [[0, 1, 2]],
                "smooth": True,
                "deformation": [
                    {"time": 0, "positions": TRIANGLE},
                    {"time": 1, "positions": [[x, y + 0.3 * x, z - 0.5] for x, y, z in TRIANGLE]},
                ],
            }
        ],
    },
    "instancing": {
        "prototypes": {"p": [quad(0), quad(0.3, transform=[{"rotate": {"axis": [0, 1, 0], "angle": 90}}])]},
        "shapes": [{"type": "instance", "prototype": "p", "transform": [{"translate": [0.8, 0.9, 0]}]}],
    },
    "round": {
        "shapes": [
            {"type": "plane"},
            {"type": "sphere", "center": [-1.6, 0.6, 0], "radius": 0.6},
            {"type": "disc", "center": [1.5, 2.2, 0], "normal": [0, 0.3, 1], "radius": 0.4},
        ]
    },
    "area_lights": {
        "shapes": [
            {
                "type": "quad",
                "origin": [-0.5, 3, 1],
                "u": [1, 0, 0],
                "v": [0, 0, 1],
                "emission": {"radiance": 9},
            }
        ]
    },
    "delta_lights": {"lights": [{"type": "point", "position": [-2, 3, 4], "intensity": 12}]},
    "many_lights": {"lights": [{"type": "spot", "position": [2, 3, 3], "direction": [-1, -1, -1]}]},
    "light_tree": {
        "integrator": {"light_selection": "tree"},
        "lights": [{"type": "point", "position": [0.5 * i, 3, 3], "intensity": 2} for i in range(9)],
    },
    "environment": {"environment": {"type": "constant", "radiance": [0.2, 0.3, 0.4]}},
    "environment_image": {"environment": {"type": "image", "image": {"file": "sky.exr"}}},
    "gloss": {
        "materials": {
            "gold": {"type": "conductor", "base_color": [0.9, 0.7, 0.3], "roughness": 0.4, "anisotropy": 0.5},
            "cone": {"type": "phong"},
            "paint": {"type": "plastic", "roughness": 0.2},
        },
        "shapes": [
            quad(-1.6, "gold"),
            quad(1.2, "cone", transform=[{"translate": [0, 1.2, 0]}]),
            quad(-2, "paint", transform=[{"translate": [0, 1.2, 0]}]),
        ],
    },
    "transmission": {
        "materials": {"leaf": {"type": "diffuse_transmission"}},
        "shapes": [quad(-0.4, "leaf", transform=[{"translate": [0, 1.1, -0.2]}])],
    },
    "textures": {
        "textures": {"t": {"type": "checker", "uv": {"scale": [3, 3]}}},
        "materials": {"checked": {"type": "diffuse", "base_color": {"texture": "t"}}},
        "shapes": [quad(-0.4, "checked", transform=[{"translate": [0, -0.2, -0.3]}])],
    },
    "indirect": {"integrator": {"max_bounces": 4}},
    "layers": {"film": {"layers": ["albedo", "normal", "depth"]}},
}
"""What has to be in a scene for it to have an effect."""

TOGETHER: Final[dict[tuple[str, str], dict[str, Any]]] = {
    ("transmission", "indirect"): {
        "materials": {
            "glass": {"type": "dielectric", "color": [0.8, 1, 0.9]},
            "sheet": {"type": "thin_dielectric"},
        },
        "shapes": [
            quad(0.9, "glass", transform=[{"translate": [0, 0, 0.6]}]),
            quad(-1.5, "sheet", transform=[{"translate": [0, 0.4, 1]}]),
        ],
    },
    ("transmission", "gloss"): {
        "materials": {"frosted": {"type": "dielectric", "roughness": 0.3}},
        "shapes": [quad(0.2, "frosted", transform=[{"translate": [0, 0.5, 1]}])],
    },
    ("gloss", "indirect"): {
        "materials": {"mirror": {"type": "mirror"}},
        "shapes": [quad(-2.6, "mirror")],
    },
}
"""What two effects can have between them: clear glass always has light to look for."""

BASE: Final[dict[str, Any]] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": TOWARDS},
    "film": {"width": WIDTH, "height": HEIGHT},
    "sampler": {"type": "sobol", "seed": 5},
    "integrator": {"max_bounces": 0, "light_selection": "uniform"},
    "shapes": [
        {"type": "quad", "origin": [-3, -0.5, -1], "u": [6, 0, 0], "v": [0, 4, 0]},
        {"type": "quad", "origin": [-3, -0.5, 2], "u": [6, 0, 0], "v": [0, 0, -3]},
    ],
}


def _merge(into: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    out = dict(into)
    for key, value in part.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict) and key != "transform":
            out[key] = _merge(out[key], value)
        elif isinstance(value, list) and isinstance(out.get(key), list):
            out[key] = [*out[key], *value]
        else:
            out[key] = value
    return out


def scene_with(effects: Iterable[str], **sections: Any) -> Scene:
    """A wall and a floor, and what the effects need. Without a light of their own they get a point light."""
    effects = set(effects)
    if "environment_image" in effects:
        effects.discard("environment")  # there is one environment
    document = BASE
    for name in EFFECTS:
        if name in effects:
            document = _merge(document, PARTS[name])
    for pair, part in TOGETHER.items():
        if effects.issuperset(pair):
            document = _merge(document, part)
    if "many_lights" in effects or not effects & {"area_lights", "environment", "environment_image"}:
        document = _merge(document, {} if "delta_lights" in effects else PARTS["delta_lights"])
    return Scene.model_validate(_merge(document, sections))


class Sky:
    """Assets that hold one image: a small sky with a sun."""

    def image(self, ref: AssetRef) -> Image:
        pixels = np.full((4, 8, 3), 0.3, np.float32)
        pixels[1, 5] = 6.0
        return Image(pixels, False)

    def mesh(self, ref: AssetRef) -> MeshData:
        raise AssertionError(f"{ref} is no mesh of these scenes")


def covering(factors: tuple[str, ...], seed: int = 1) -> list[frozenset[str]]:
    """Sets of factors such that every two of them occur both in, both out, and either without the other.

    Greedy: each set is the best of a hundred random ones (Cohen, Dalal, Fredman, Patton 1997, AETG).
    """
    draw = random.Random(seed)
    missing = {
        ((a, x), (b, y))
        for a, b in itertools.combinations(factors, 2)
        for x, y in itertools.product((False, True), repeat=2)
    }

    def covered(chosen: frozenset[str]) -> set[Any]:
        return {pair for pair in missing if all((name in chosen) == on for name, on in pair)}

    found = []
    while missing:
        some = [frozenset(f for f in factors if draw.random() < 0.5) for _ in range(100)]
        best = max(some, key=lambda chosen: len(covered(chosen)))
        if gained := covered(best):
            missing -= gained
            found.append(best)
    return found
