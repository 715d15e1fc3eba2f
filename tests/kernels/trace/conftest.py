"""Rendering small scenes straight through the tracer, and reading means and variances off the sum nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import Assets, NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

LOOK_DOWN_Z = {"look_at": {"origin": [0, 0, 0], "target": [0, 0, -1]}}


@dataclass(frozen=True)
class Picture:
    """Pixel means (h, w, 3), the variance of each mean, alpha, and the node itself."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    alpha: NDArray[np.float64]
    node: SumNode

    def z_of(self, truth: float | NDArray[np.float64]) -> float:
        """Standard errors between the picture's overall mean and the truth."""
        n = self.variance.size
        error = np.sqrt(self.variance.sum()) / n
        return float((self.mean.mean() - np.mean(truth)) / max(error, 1e-12))


def picture_of(node: SumNode) -> Picture:
    """Means and variances over replicates; replicates of a pixel that got no sample are left out."""
    taken = node.sums["taken"].astype(np.float64)[..., None]
    rgba = np.where(taken > 0, node.sums["rgba"].astype(np.float64) / np.maximum(taken, 1), 0)
    r = (taken > 0).sum(axis=0)
    mean = rgba.sum(axis=0) / np.maximum(r, 1)
    spread = np.where(taken > 0, (rgba - mean) ** 2, 0).sum(axis=0)
    variance = np.where(r > 1, spread / np.maximum(r * (r - 1), 1), np.nan)
    return Picture(mean[..., :3], variance[..., :3], mean[..., 3], node)


Render = Callable[..., Picture]


@pytest.fixture(scope="session")
def render(device: Device) -> Render:
    """render(scene, samples=64, replicates=8, program='generic', tile=None, assets=None) -> Picture."""

    def run(
        scene: dict[str, Any],
        samples: int = 64,
        replicates: int = 8,
        program: str = "generic",
        tile: Tile | None = None,
        assets: Assets | None = None,
        strata: int | None = None,
        time: float = 0.0,
    ) -> Picture:
        model = Scene.model_validate({"version": 1, **scene})
        compiled = compile_scene(model, assets or NoAssets(), time)
        count = max(samples // replicates, 1)
        plan = SamplePlan(replicates, count if strata is None else strata)
        tracer = Tracer(device, compiled, plan, program=program)
        node = tracer.trace(tile or Tile(0, 0, model.film.width, model.film.height), 0, count)
        assert node.sums["rejected"].sum() == 0
        return picture_of(node)

    return run


def camera(**keys: Any) -> dict[str, Any]:
    """A perspective camera at the origin that looks along -Z."""
    return {"type": "perspective", "fov": 40, "transform": LOOK_DOWN_Z, **keys}


def film(side: int = 16, **keys: Any) -> dict[str, Any]:
    return {"width": side, "height": side, **keys}
