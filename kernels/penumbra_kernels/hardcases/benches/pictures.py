"""Small pictures straight through the tracer: means and variances off the sum nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene

from penumbra_kernels.assets import Assets, NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.tracer import SamplePlan, Tracer


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


class Renderer:
    """render(scene, samples=64, replicates=8, program='generic', ...) -> Picture. Scenes in JSON, without a version."""

    def __init__(self, device: Device) -> None:
        self.device = device

    def __call__(
        self,
        scene: dict[str, Any] | Scene,
        samples: int = 64,
        replicates: int = 8,
        program: str = "generic",
        tile: Tile | None = None,
        assets: Assets | None = None,
        strata: int | None = None,
        time: float = 0.0,
    ) -> Picture:
        model = scene if isinstance(scene, Scene) else Scene.model_validate({"version": 1, **scene})
        compiled = compile_scene(model, assets or NoAssets(), time)
        count = max(samples // replicates, 1)
        plan = SamplePlan(replicates, count if strata is None else strata)
        tracer = Tracer(self.device, compiled, plan, program=program)
        return picture_of(tracer.trace(tile or Tile(0, 0, model.film.width, model.film.height), 0, count))


def busy(sampler: str = "sobol", selection: str = "power", side: int = 0) -> Scene:
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
            "film": {"width": side or 24, "height": side or 20},
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
