"""Counted as paths are traced: what needs no random number draws none, and sends no ray. Both programs of a scene alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.allotment import Allotment
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.dimensions import drawn_per_path
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

SIDE = 8
TILE = Tile(0, 0, SIDE, SIDE)
POINT = {"type": "point", "position": [0, 0, 0], "intensity": 1}
LAMP = {"type": "quad", "origin": [-1, -1, 2], "u": [0, 2, 0], "v": [2, 0, 0], "emission": {"radiance": 1}}
SKY = {"environment": {"type": "constant"}, "lights": []}


def wall(material: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """A wall that fills the picture, and whatever lights it."""
    return {
        "version": 1,
        "camera": {"type": "orthographic", "height": 1},
        "film": {"width": SIDE, "height": SIDE},
        "materials": {"m": material},
        "shapes": [
            {"type": "quad", "origin": [-5, -5, -2], "u": [10, 0, 0], "v": [0, 10, 0], "material": "m"}
        ],
        "lights": [POINT],
        "integrator": {"max_bounces": 0},
        **sections,
    }


PAINT = {"type": "diffuse", "base_color": 0.5}
MIRROR = {"type": "mirror"}
BOUNCE = {"integrator": {"max_bounces": 1, "roulette_start": 9}}
SOME = None
CASES: dict[str, tuple[dict[str, Any], dict[str, float], int | None]] = {
    "a delta light": (wall(PAINT), {"pixel": 2}, 2),
    "three shadow rays to it": (
        wall(PAINT, integrator={"max_bounces": 0, "shadow_rays": 3}),
        {"pixel": 2},
        4,
    ),
    "two delta lights": (wall(PAINT, lights=[POINT] * 2), {"pixel": 2, "point on the light": 2}, 2),
    "a sky": (wall(PAINT, **SKY), {"pixel": 2, "point on the light": 2}, 2),
    "a sharp mirror": (wall(MIRROR, **SKY, **BOUNCE), {"pixel": 2}, 2),
    "a sharp mirror and a delta light": (wall(MIRROR, **BOUNCE), {"pixel": 2}, 2),
    "rough metal": (
        wall({"type": "conductor", "roughness": 0.3}, **SKY, **BOUNCE),
        {"pixel": 2, "point on the light": 2, "direction": 2},
        SOME,
    ),
    "sharp metal": (wall({"type": "conductor", "roughness": 0}, **SKY, **BOUNCE), {"pixel": 2}, 2),
    "sharp glass": (
        wall({"type": "thin_dielectric"}, **SKY, **BOUNCE),
        {"pixel": 2, "lobe": 1},
        2,
    ),
    "lacquer": (
        wall({"type": "plastic", "roughness": 0.3}, **SKY, **BOUNCE),
        {"pixel": 2, "point on the light": 2, "direction": 2},
        SOME,
    ),
    "paint and a bounce": (
        wall(PAINT, **BOUNCE),
        {"pixel": 2, "direction": 2},
        3,
    ),
    "a lamp, black behind": (
        wall(
            PAINT,
            shapes=[{**LAMP, "origin": [-1, -1, -2], "u": [2, 0, 0], "v": [0, 2, 0]}],
            lights=[],
            **BOUNCE,
        ),
        {"pixel": 2},
        1,
    ),
    "a pinhole": (wall(PAINT, shapes=[]), {"pixel": 2}, 1),
    "a lens": (
        wall(PAINT, shapes=[], camera={"type": "perspective", "lens": {"aperture_radius": 0.1}}),
        {"pixel": 2, "lens": 2},
        1,
    ),
}
"""A scene, the numbers that a path draws, and its rays; `SOME`: one less where a lobe's direction is below the horizon."""


@pytest.mark.parametrize("program", ["specialised", "generic"])
@pytest.mark.parametrize("name", CASES)
def test_numbers_and_rays_of_a_path(device: Device, name: str, program: str) -> None:
    scene, numbers, rays = CASES[name]
    compiled = compile_scene(Scene.model_validate(scene), NoAssets())
    tracer = Tracer(device, compiled, SamplePlan(2, 8), program=program, measuring=True)
    draws = drawn_per_path(tracer, [TILE], 8)
    unused = {"lens", "time"} if program == "generic" else set()  # of the camera's, the program decides alone
    assert {key: value for key, value in draws.items() if key in numbers or key not in unused} == numbers
    traced = int(tracer.trace(TILE, 0, 8).sums["rays"].sum()) / (8 * 2 * SIDE * SIDE)
    assert traced == rays if rays is not SOME else 1 < traced <= 3


@pytest.mark.parametrize("sampler", ["independent", "stratified", "jittered", "sobol", "blue_noise"])
def test_every_sampler_counts_what_its_paths_draw(device: Device, sampler: str) -> None:
    scene = {**CASES["a sky"][0], "sampler": {"type": sampler}}
    tracer = Tracer(
        device, compile_scene(Scene.model_validate(scene), NoAssets()), SamplePlan(2, 8), measuring=True
    )
    assert drawn_per_path(tracer, [TILE], 8) == {"pixel": 2, "point on the light": 2}


def test_a_program_that_does_not_measure_counts_nothing(device: Device) -> None:
    compiled = compile_scene(Scene.model_validate(CASES["a sky"][0]), NoAssets())
    tracer = Tracer(device, compiled, SamplePlan(2, 8))
    assert drawn_per_path(tracer, [TILE], 8) == {}


def test_pixels_that_take_fewer_samples_draw_fewer_numbers(device: Device) -> None:
    """What has converged draws no more than it is allotted."""
    scene = {**CASES["a sky"][0], "adaptive": {"strategy": "error"}, "stop": {"samples": 64}}
    compiled = compile_scene(Scene.model_validate(scene), NoAssets())
    tracer = Tracer(device, compiled, SamplePlan(2, 8), measuring=True)
    levels = np.zeros((SIDE, SIDE), np.uint8)
    levels[:, SIDE // 2 :] = 2  # a quarter of the samples
    sums = tracer.trace(TILE, 0, 8, Allotment(levels, planned=8, kept=0)).sums
    taken = sums["taken"].sum(axis=0)
    assert (taken == np.where(levels == 0, 16, 4)).all()
    paths = int(taken.sum())
    assert dict(zip(("pixel", "point on the light"), tracer.drawn[[0, 3]] / paths, strict=True)) == {
        "pixel": 2,
        "point on the light": 2,
    }
