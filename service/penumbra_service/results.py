"""Writes what a finished run leaves in its folder: EXR, thumbnail, noise map, receipt."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile
from penumbra_scene.job import StopReason
from penumbra_scene.receipt import AdaptiveReport, Receipt
from penumbra_scene.scene import Scene

from penumbra_service.engine.runner import RunResult
from penumbra_service.film.develop import Developed, float_channels, integer_channels
from penumbra_service.film.preview import PreviewImage
from penumbra_service.images.exr import ExrLayout, write_exr
from penumbra_service.images.heatmap import write_heatmap
from penumbra_service.images.resize import fitted_size
from penumbra_service.images.thumbnail import write_thumbnail
from penumbra_service.jobs.receipt import ReceiptContext, build_receipt

RESULT: Final = "result.exr"
THUMBNAIL: Final = "thumbnail.png"
HEATMAP: Final = "heatmap.png"
RECEIPT: Final = "receipt.json"
ALL: Final = (RESULT, THUMBNAIL, HEATMAP, RECEIPT)
"""What a picture leaves."""
CONTACT_SHEET: Final = "contact_sheet.png"
MOVIE: Final = "preview.mp4"
OF_SEQUENCE: Final = (CONTACT_SHEET, MOVIE)
"""What a job of several frames leaves besides what each of them does."""
FRAMES: Final = "frames"


def frame_folder(frame: int) -> str:
    """Where a frame's files lie, relative to its job's: names sort as numbers do up to 9999."""
    return f"{FRAMES}/{frame:04d}"


ATTRIBUTE: Final = "penumbra:"
"""Before the names of our own attributes in the EXR."""
_FULL_PICTURE_BYTES: Final = 256 << 20
"""Up to this size the whole picture may wait in memory for a thumbnail larger than the preview."""


@dataclass
class Latest:
    """The newest preview of a run."""

    image: PreviewImage | None = field(default=None)
    written: bool = False
    """Whether its thumbnail and noise map are in the folder."""


def write_pictures(folder: Path, scene: Scene, image: PreviewImage) -> None:
    """The thumbnail and the noise map of a run as it stands. Raises OSError."""
    look = scene.film.thumbnail
    rgb = image.rgba[..., :3]
    write_thumbnail(folder / THUMBNAIL, rgb, exposure=look.exposure, view=look.view, max_side=look.max_side)
    # The average of n pixels has a variance of about 1/n of theirs; the map shows that of single pixels.
    variance = image.variance * np.float32(image.scale**2)
    write_heatmap(folder / HEATMAP, rgb, variance, max_side=look.max_side)


def write_results(
    folder: Path, scene: Scene, result: RunResult, latest: Latest, context: ReceiptContext
) -> Receipt:
    """All files of a run that reached its stop rule. Raises OSError."""
    began = time.perf_counter()
    reason = result.reason or StopReason.SAMPLES
    draft = build_receipt(scene, result.record, reason, context, result.levels)
    keep = _Keeper(scene) if _wants_full(scene, latest.image) else None
    bands = result.bands()
    write_exr(folder / RESULT, exr_layout(scene, draft), bands if keep is None else keep.pass_on(bands))
    if latest.image is not None and not latest.written:
        write_pictures(folder, scene, latest.image)
    if keep is not None:
        look = scene.film.thumbnail
        write_thumbnail(
            folder / THUMBNAIL, keep.rgb, exposure=look.exposure, view=look.view, max_side=look.max_side
        )
    done = replace(context, finished=datetime.now(UTC), write_seconds=time.perf_counter() - began)
    receipt = build_receipt(scene, result.record, reason, done, result.levels)
    _write_text(folder / RECEIPT, receipt.model_dump_json(indent=1) + "\n")
    return receipt


def exr_layout(scene: Scene, receipt: Receipt) -> ExrLayout:
    """Channels, windows and attributes of a picture."""
    film = scene.film
    window = film.window
    return ExrLayout(
        Tile(window.x, window.y, window.width, window.height),
        film.width,
        film.height,
        float_channels(film.layers),
        integer_channels(film.layers),
        film.half,
        attributes(receipt),
    )


def attributes(receipt: Receipt) -> dict[str, str | int | float]:
    """What the EXR says of its own making. The seed is a string: it has 64 bits."""
    ours: dict[str, str | int | float] = {
        "job": receipt.job,
        "variance": receipt.error.method,
        "sampler": receipt.sampler,
        "seed": receipt.seed,
        "replicates": receipt.replicates,
        "samples": float(receipt.samples),
        "filter": receipt.film.filter.model_dump_json(),
        "effects": " ".join(effect.name for effect in receipt.effects_in),
        "effectsLeftOut": " ".join(effect.name for effect in receipt.effects_out),
        "notCovered": "; ".join(limit.name for limit in receipt.not_covered),
        "seconds": receipt.forecast.real_seconds,
        "deviceSeconds": receipt.stages.trace.seconds,
        "stopReason": str(receipt.stop_reason),
        "flaggedShare": receipt.counts.flagged_share,
        "rejectedSamples": str(receipt.counts.rejected),
        "sceneHash": receipt.scene_hash,
        "pictureHash": receipt.picture_hash or "",
        "programHash": receipt.program_hash or "",
        "kernelHash": receipt.kernel_hash or "",
        "bitClass": receipt.bit_class,
        "versions": " ".join(f"{name}={version}" for name, version in receipt.versions.items()),
        **_adaptive(receipt.adaptive),
    }
    if receipt.frame is not None:
        ours["frame"] = receipt.frame
        ours["time"] = receipt.time
    if receipt.error.relmse is not None and receipt.error.relative_error is not None:
        ours["relmse"] = receipt.error.relmse
        ours["relativeError"] = receipt.error.relative_error
    if receipt.error.theta is not None:
        ours["theta"] = receipt.error.theta
    if receipt.forecast.predicted_samples is not None and receipt.forecast.predicted_seconds is not None:
        ours["predictedSamples"] = receipt.forecast.predicted_samples
        ours["predictedSeconds"] = receipt.forecast.predicted_seconds
    named: dict[str, str | int | float] = {ATTRIBUTE + name: value for name, value in ours.items()}
    return {
        "Software": f"Penumbra {receipt.versions.get('penumbra-render', '')}".strip(),
        "comments": receipt.name,
        **named,
    }


def _adaptive(report: AdaptiveReport | None) -> dict[str, str | int | float]:
    if report is None:
        return {"biased": "no", "adaptive": "off"}
    biased = (
        "yes: the samples that decided where more are taken stay in the picture" if report.biased else "no"
    )
    return {
        "biased": biased,
        "adaptive": report.strategy if report.strategy == "contrast" else f"error, {report.mode}",
        "pilotSamples": report.pilot_samples,
        "pilotSeconds": report.pilot_seconds,
        "sampleLevels": " ".join(f"{level.samples}:{level.share:.4f}" for level in report.levels),
        **({} if report.shadow_rays is None else {"shadowRays": report.shadow_rays}),
    }


def _wants_full(scene: Scene, preview: PreviewImage | None) -> bool:
    """Whether the thumbnail is to be larger than the preview, and the picture small enough to keep."""
    window = scene.film.window
    wanted = fitted_size(window.width, window.height, scene.film.thumbnail.max_side)
    have = (0, 0) if preview is None else (preview.rgba.shape[1], preview.rgba.shape[0])
    return wanted[0] > have[0] and window.width * window.height * 12 <= _FULL_PICTURE_BYTES


class _Keeper:
    """Keeps R, G and B of the bands that pass."""

    def __init__(self, scene: Scene) -> None:
        window = scene.film.window
        self._top = window.y
        self.rgb: NDArray[np.float32] = np.zeros((window.height, window.width, 3), np.float32)

    def pass_on(self, bands: Iterator[Developed]) -> Iterator[Developed]:
        for band in bands:
            first = band.tile.y - self._top
            for i, name in enumerate("RGB"):
                self.rgb[first : first + band.tile.height, :, i] = band.floats[name]
            yield band


def _write_text(path: Path, text: str) -> None:
    aside = path.with_name(f".{path.name}.part")
    aside.write_text(text, encoding="utf-8")
    aside.replace(path)
