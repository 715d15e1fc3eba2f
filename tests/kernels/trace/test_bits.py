"""Who renders, in which tile, in which order and with which program changes no bit."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile, merge
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

SAMPLERS = ["regular", "random", "independent", "stratified", "jittered", "sobol", "blue_noise"]


def busy(sampler: str = "sobol", selection: str = "power") -> Scene:
    """Every kind of light, gloss, glass, texture and motion in one small picture."""
    return Scene.model_validate(
        {
            "version": 1,
            "camera": {
                "type": "perspective",
                "transform": {"look_at": {"origin": [0, 1.5, 6], "target": [0, 0.8, 0]}},
                "lens": {"aperture_radius": 0.05, "focus_distance": 6, "blades": 5},
                "shutter": {"open": 0, "close": 0.5},
            },
            "film": {"width": 24, "height": 20},
            "sampler": {"type": sampler, "seed": 7},
            "integrator": {"max_bounces": 6, "light_selection": selection},
            "textures": {"check": {"type": "checker", "uv": {"scale": [4, 4]}}},
            "materials": {
                "floor": {"type": "diffuse", "base_color": {"texture": "check"}},
                "gold": {"type": "conductor", "base_color": [0.9, 0.7, 0.3], "roughness": 0.4},
                "glass": {"type": "dielectric", "roughness": 0.2},
            },
            "shapes": [
                {"type": "plane", "material": "floor"},
                {"type": "sphere", "center": [-1, 0.8, 0], "radius": 0.8, "material": "gold"},
                {"type": "sphere", "center": [1, 0.7, 0.5], "radius": 0.7, "material": "glass"},
                {
                    "type": "quad",
                    "origin": [-0.3, 0.1, 1.5],
                    "u": [0.6, 0, 0],
                    "v": [0, 0.6, 0],
                    "transform": {
                        "keyframes": [
                            {"time": 0, "transform": []},
                            {"time": 1, "transform": [{"translate": [1, 0, 0]}]},
                        ]
                    },
                },
                {
                    "type": "disc",
                    "center": [0, 4, 0],
                    "normal": [0, -1, 0],
                    "radius": 0.7,
                    "emission": {"radiance": 8},
                },
            ],
            "lights": [{"type": "point", "position": [3, 3, 3], "intensity": 5}],
            "environment": {"type": "constant", "radiance": 0.2},
        }
    )


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_tiles_and_leases_change_no_bit(device: Device, sampler: str) -> None:
    replicates = 1 if sampler == "regular" else 4
    tracer = Tracer(
        device, compile_scene(busy(sampler), NoAssets()), SamplePlan(replicates, 8), program="generic"
    )
    whole = tracer.trace(Tile(0, 0, 24, 20), 0, 8).sums
    assert whole["lit"].sum() > 0
    for tile in (Tile(0, 0, 7, 5), Tile(7, 5, 1, 1), Tile(11, 3, 13, 17)):
        halves = [
            merge(tracer.trace(tile, 4 * k, 2), tracer.trace(tile, 4 * k + 2, 2))
            if k
            else tracer.trace(tile, 0, 4)
            for k in (0, 1)
        ]
        part = merge(*halves).sums
        window = whole[:, tile.y : tile.y + tile.height, tile.x : tile.x + tile.width]
        assert part.tobytes() == np.ascontiguousarray(window).tobytes()


@pytest.mark.parametrize("selection", ["power", "tree"])
def test_the_generic_program_gives_the_specialised_ones_bits(device: Device, selection: str) -> None:
    compiled = compile_scene(busy(selection=selection), NoAssets())
    nodes = [
        Tracer(device, compiled, SamplePlan(4, 8), program=program).trace(Tile(0, 0, 24, 20), 0, 8)
        for program in ("specialised", "generic")
    ]
    assert nodes[0].sums.tobytes() == nodes[1].sums.tobytes()


def test_seeds_differ(device: Device) -> None:
    sums = []
    for seed in (1, 2):
        scene = busy()
        scene = scene.model_copy(update={"sampler": scene.sampler.model_copy(update={"seed": seed})})
        sums.append(
            Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(2, 4), program="generic")
            .trace(Tile(0, 0, 24, 20), 0, 4)
            .sums
        )
    surface = (sums[0]["rgba"][..., 3] == 4) & (sums[1]["rgba"][..., 3] == 4)  # the sky is the same for all
    assert (sums[0]["rgba"][surface, 0] != sums[1]["rgba"][surface, 0]).mean() > 0.99


def test_layers_of_the_plane_wide_sampler_are_means_over_all_its_paths(device: Device) -> None:
    """A wall that fills the picture: albedo and depth are the same on every path, so their means are exact."""
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "orthographic", "height": 1},
            "film": {"width": 8, "height": 8, "layers": ["albedo", "normal", "depth"]},
            "sampler": {"type": "random", "seed": 3},
            "materials": {"m": {"type": "diffuse", "base_color": 0.5}},
            "shapes": [
                {"type": "quad", "origin": [-5, -5, -2], "u": [10, 0, 0], "v": [0, 10, 0], "material": "m"}
            ],
        }
    )
    tracer = Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(2, 16))
    node = tracer.trace(Tile(0, 0, 8, 8), 0, 16)
    assert node.layers is not None
    taken = node.sums["taken"]
    assert taken.sum() == 2 * 16 * 64
    assert (taken != 16).any()
    assert node.layers["albedo_depth"][..., 0] == pytest.approx(0.5 * taken, rel=1e-6)
    assert node.layers["albedo_depth"][..., 3] == pytest.approx(2.0 * taken, rel=1e-5)
    assert node.layers["normal"][..., 2] == pytest.approx(1.0 * taken, rel=1e-6)
