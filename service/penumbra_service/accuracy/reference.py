"""Long renders that others are measured against, kept on disk, and the error against them."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels import cache
from penumbra_scene.check import picture_hash
from penumbra_scene.scene import Scene
from penumbra_scene.settings import Sampler, Stop

from penumbra_service.engine.snapshot import kernel_hash
from penumbra_service.engine.task import RunResult
from penumbra_service.film.error import EPSILON

SURE: Final = 2.0
"""Standard deviations from which an error counts as told by a reference: about 95 %."""
SEED: Final = 0x5265_6665_7265_6E63
"""Of references: no render that is measured against one should share its samples."""


@dataclass(frozen=True)
class Picture:
    """A render's pixels in float64."""

    rgb: NDArray[np.float64]
    """(height, width, 3)."""
    variance: NDArray[np.float64]
    """Of these means; NaN where it is not known."""
    samples: float
    """A pixel, on average."""


def picture_of(result: RunResult) -> Picture:
    """All bands of a render that is there."""
    bands = list(result.bands())
    whole = {
        name: np.concatenate([{**b.floats, **b.integers}[name] for b in bands])
        for name in ("R", "G", "B", "Variance.R", "Variance.G", "Variance.B", "SampleCount", "InvalidCount")
    }
    taken = whole["SampleCount"].astype(np.float64) + whole["InvalidCount"]
    return Picture(
        np.stack([whole[c] for c in "RGB"], axis=-1).astype(np.float64),
        np.stack([whole[f"Variance.{c}"] for c in "RGB"], axis=-1).astype(np.float64),
        float(taken.mean()),
    )


@dataclass(frozen=True)
class Told:
    """An error against a reference."""

    relmse: float
    """Without bias, so that it may be negative where it is far below the reference's own."""
    deviation: float
    """Standard, of `relmse`: pixels are independent of each other."""

    @property
    def known(self) -> bool:
        """Whether it is told apart from nothing, by SURE deviations."""
        return self.relmse > SURE * self.deviation

    @property
    def bound(self) -> float:
        """What the true one is most likely below."""
        return max(self.relmse, 0.0) + SURE * self.deviation


def relmse_ref(picture: Picture, truth: Picture) -> Told:
    """Mean over pixels and R G B of ((m - ref)^2 - V_ref) / (ref^2 + 0.01).

    The reference errs as well: since it is independent of the picture, its variance V_ref adds to the square on average,
    and is taken off again.
    """
    square = (picture.rgb - truth.rgb) ** 2 - np.nan_to_num(truth.variance)
    each = np.mean(square / (truth.rgb**2 + EPSILON), axis=-1)
    return Told(float(each.mean()), float(each.std() / math.sqrt(each.size)))


def own_relmse(picture: Picture) -> float:
    """The error of a picture as its own variance tells it: mean of V / (m^2 + 0.01)."""
    return float(np.mean(picture.variance / (picture.rgb**2 + EPSILON)))


Render = Callable[[Scene], tuple[Picture, RunResult]]


@dataclass(frozen=True)
class Reference:
    """How long references are, and where they are kept."""

    samples: int
    folder: Path | None = None
    """None: with the programs' cache."""

    def get(self, scene: Scene, time: float, render: Render) -> Picture:
        """From disk, or rendered now. Raises RunFailedError, OSError."""
        path = self._path(scene, time)
        kept = _read(path)
        if kept is None:
            update = {
                "sampler": Sampler(type="sobol", seed=SEED),
                "stop": Stop(samples=self.samples),
                "adaptive": None,
            }
            kept, _ = render(scene.model_copy(update=update))
            _write(path, kept)
        return kept

    def _path(self, scene: Scene, time: float) -> Path:
        """By what is looked at and by the kernels that look: nothing else changes what a reference should be."""
        folder = self.folder or cache.folder() / "references"
        shown = picture_hash(scene, time).removeprefix("sha256:")
        return folder / f"{shown[:32]}-{kernel_hash()[:16]}-{self.samples}.npz"


def _read(path: Path) -> Picture | None:
    """A broken file is as good as none."""
    try:
        with np.load(path) as data:
            return Picture(data["rgb"], data["variance"], float(data["samples"]))
    except (OSError, ValueError, KeyError, EOFError):
        return None


def _write(path: Path, picture: Picture) -> None:
    file = io.BytesIO()
    np.savez_compressed(file, rgb=picture.rgb, variance=picture.variance, samples=np.float64(picture.samples))
    cache.put(path, file.getvalue())
