"""Rendering small scenes straight through the tracer, and reading means and variances off the sum nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.pictures import Picture, Renderer

LOOK_DOWN_Z = {"look_at": {"origin": [0, 0, 0], "target": [0, 0, -1]}}

Render = Callable[..., Picture]


@pytest.fixture(scope="session")
def render(device: Device) -> Render:
    """render(scene, samples=64, replicates=8, program='generic', tile=None, assets=None) -> Picture."""
    renderer = Renderer(device)

    def run(scene: dict[str, Any], **keys: Any) -> Picture:
        picture = renderer(scene, **keys)
        assert picture.node.sums["rejected"].sum() == 0
        return picture

    return run


def camera(**keys: Any) -> dict[str, Any]:
    """A perspective camera at the origin that looks along -Z."""
    return {"type": "perspective", "fov": 40, "transform": LOOK_DOWN_Z, **keys}


def film(side: int = 16, **keys: Any) -> dict[str, Any]:
    return {"width": side, "height": side, **keys}
