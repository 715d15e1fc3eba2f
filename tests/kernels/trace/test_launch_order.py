"""On GPUs work-items take pixels in another order: the same sums, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

SCENE = {
    "version": 1,
    "camera": {"type": "perspective"},
    "film": {"width": 64, "height": 48},
    "shapes": [{"type": "sphere", "center": [0, 0, -3]}],
    "environment": {"type": "constant", "radiance": [0.2, 0.5, 0.9]},
}


class Ordered(Device):
    """A device whose program takes pixels as GPUs do."""

    @property
    def flags(self) -> dict[str, int]:
        return {**super().flags, "PENUMBRA_DEVICE_GPU": 1}


@pytest.mark.parametrize("tile", [Tile(0, 0, 64, 48), Tile(8, 4, 24, 12), Tile(3, 5, 13, 7)], ids=str)
def test_the_order_of_work_items_changes_no_pixel(device: Device, tile: Tile) -> None:
    compiled = compile_scene(Scene.model_validate(SCENE), NoAssets())
    plain = Tracer(device, compiled, SamplePlan(3, 0)).trace(tile, 0, 4)
    ordered = Tracer(Ordered(device.info.id), compiled, SamplePlan(3, 0)).trace(tile, 0, 4)
    assert np.ptp(plain.sums["rgba"]) > 0
    assert plain.sums.tobytes() == ordered.sums.tobytes()
