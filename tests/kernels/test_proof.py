"""Two programs of a scene are compared on the device before one takes over: equal bits, or none of it."""

from __future__ import annotations

from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.proof import compare
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

SCENE = Scene.model_validate(
    {
        "version": 1,
        "camera": {"type": "perspective", "transform": [{"translate": [0, 0, 3]}]},
        "film": {"width": 40, "height": 24, "layers": ["normal"]},
        "shapes": [{"type": "sphere"}],
        "environment": {"type": "constant"},
    }
)
WINDOW = Tile(0, 0, 40, 24)


def test_a_scenes_own_program_is_proven_equal_and_timed(device: Device) -> None:
    generic = Tracer(device, compile_scene(SCENE, NoAssets()), SamplePlan(4), program="generic")
    own = generic.specialised()
    assert own.flags != generic.flags
    assert own.flags == Tracer(device, compile_scene(SCENE, NoAssets()), SamplePlan(4)).flags
    assert own.scene_bytes <= generic.scene_bytes
    gain = compare(own, generic, WINDOW)
    assert gain is not None
    assert gain > 0


def test_one_other_sample_is_found(device: Device) -> None:
    generic = Tracer(device, compile_scene(SCENE, NoAssets()), SamplePlan(4), program="generic")
    own = generic.specialised()
    own.reseed(int(SCENE.sampler.seed) + 1)
    assert compare(own, generic, WINDOW) is None
