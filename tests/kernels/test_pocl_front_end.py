"""What PoCL's front end is spared changes no bits, and other drivers are asked for nothing."""

from __future__ import annotations

from typing import Any, Final

import pytest
from penumbra_kernels import pocl_front_end
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import BuildError, Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

SCENE: Final[dict[str, Any]] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": [{"translate": [0, 0.5, 4]}]},
    "film": {"width": 16, "height": 16},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.6}},
    "shapes": [
        {"type": "plane", "material": "gray"},
        {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.8, "material": "gray"},
        {"type": "quad", "origin": [-1, 3, -1], "u": [2, 0, 0], "v": [0, 0, 2], "emission": {"radiance": 5}},
    ],
}


@pytest.fixture
def known(device: Device) -> Device:
    if not pocl_front_end.is_known(device.info.platform_version):
        pytest.skip(f"{device.info.platform_version} is asked for nothing")
    return device


def left_alone(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    monkeypatch.setattr(pocl_front_end, "_KNOWN", "no such driver")
    return Device(device.info.id)


def test_a_program_that_the_front_end_was_spared_gives_the_same_bits(
    known: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = compile_scene(Scene.model_validate(SCENE), NoAssets())

    def trace(device: Device) -> bytes:
        return Tracer(device, compiled, SamplePlan(2, 16)).trace(Tile(0, 0, 16, 16), 0, 16).sums.tobytes()

    assert trace(known) == trace(left_alone(known, monkeypatch))


def test_the_level_reaches_clang(known: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """clang defines __OPTIMIZE__ at every level but 0, which stands in for 1 here."""
    text = """
#if defined(__OPTIMIZE__) || !PENUMBRA_OPTIMISED_ONCE
#error the level is another
#endif
__kernel void k(__global float *out) { out[0] = 1.0f; }
"""
    with pytest.raises(BuildError, match="the level is another"):
        known.build("level", {}, text)
    monkeypatch.setattr(pocl_front_end, "_ONCE", pocl_front_end._ONCE.replace("-O1", "-O0"))
    Device(known.info.id).build("level", {}, text)


def test_a_function_that_is_not_declared_is_an_error_with_its_name(known: Device) -> None:
    with pytest.raises(BuildError, match="native_exp"):
        known.build(
            "bare", {"PENUMBRA_BARE": 1}, "__kernel void k(__global float *x) { x[0] = native_exp(x[1]); }"
        )


@pytest.mark.parametrize(
    "version", ["OpenCL 3.0 CUDA 12.4", "OpenCL 3.0 PoCL 5.0  Linux", "OpenCL 1.2 Oclgrind"]
)
def test_other_drivers_are_asked_for_nothing(version: str) -> None:
    assert pocl_front_end.options(version) == ()
    assert not pocl_front_end.is_known(version)
