"""Who renders, in which tile, in which order and with which program changes no bit."""

from __future__ import annotations

import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.pictures import busy
from penumbra_kernels.nodes import Tile, merge
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

SAMPLERS = ["regular", "random", "independent", "stratified", "jittered", "sobol", "blue_noise"]


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
        assert part.tobytes() == window.tobytes()


@pytest.mark.parametrize(
    "integrator", [{}, {"shadow_rays": 3}, {"light_selection": "all", "shadow_rays": 2}], ids=str
)
def test_paths_taken_together_are_the_paths_taken_alone(
    device: Device, integrator: dict[str, object]
) -> None:
    """Whatever their length: in a room, with long paths and a roulette."""
    data = busy().model_dump(mode="json", exclude_none=True)
    data["integrator"] |= {"max_bounces": 14, "roulette_start": 9, **integrator}
    data["materials"]["wall"] = {"type": "diffuse", "base_color": [0.95, 0.95, 0.95]}
    data["shapes"].append({"type": "sphere", "center": [0, 0, 0], "radius": 12, "material": "wall"})
    scene = Scene.model_validate(data)
    tracer = Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(2, 16), program="generic")
    tile = Tile(4, 3, 16, 14)
    nodes = [tracer.trace(tile, i, 1) for i in range(16)]
    while len(nodes) > 1:
        nodes = [merge(a, b) for a, b in zip(nodes[::2], nodes[1::2], strict=True)]
    together = tracer.trace(tile, 0, 16)
    assert together.sums["rays"].max() > 16 * 14
    assert together.sums.tobytes() == nodes[0].sums.tobytes()


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


def test_a_scene_that_is_let_go_renders_the_same(device: Device) -> None:
    """The device's copy is all that is left of what the program reads."""
    kept, gone = (compile_scene(busy(), NoAssets()) for _ in range(2))
    tracers = [
        Tracer(device, kept, SamplePlan(2, 2), program="generic"),
        Tracer(device, gone, SamplePlan(2, 2), program="generic", keep_arrays=False),
    ]
    assert {"nodes", "packets", "positions", "lights"} <= kept.arrays.keys()
    assert not {"nodes", "packets", "positions", "lights"} & gone.arrays.keys()
    a, b = (tracer.trace(Tile(0, 0, 24, 20), 0, 2).sums for tracer in tracers)
    assert a.tobytes() == b.tobytes()
