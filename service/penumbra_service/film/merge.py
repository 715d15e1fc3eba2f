"""Several independent renders of one picture taken together, pixel by pixel: their mean and its variance.

With m_i the means of the renders, V_i the variances of these means and w_i = n_i / sum n the shares of the
samples, the mean is sum w_i m_i and its variance sum w_i^2 V_i: renders with different seeds are independent.
The weights come from sample counts, never from the values or the variances: those would weigh dark pixels up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from penumbra_service.film import flags
from penumbra_service.film.counts import count_untrusted
from penumbra_service.film.develop import LAYER_CHANNELS, RGBA, Developed
from penumbra_service.film.error import ImageError, TileSummary, block_sums, image_error
from penumbra_service.film.statistics import LARGEST

_MOST: Final = int(np.iinfo(np.uint32).max)
_OF_VARIANCE: Final = flags.NO_VARIANCE | flags.DETERMINISTIC
_LAYERS: Final = frozenset(name for names in LAYER_CHANNELS.values() for name in names)


def merge_bands(parts: Sequence[Developed]) -> Developed:
    """One band of the merged picture from the same band of every render.

    Pixels that are empty in some renders come from the others. What makes a render's error bar untrustworthy
    makes the merged one so. Raises ValueError where the bands do not match.
    """
    first = parts[0]
    if any(part.tile != first.tile or part.floats.keys() != first.floats.keys() for part in parts):
        raise ValueError("bands of different pixels or channels cannot be merged")
    counts = np.stack([part.integers["SampleCount"] for part in parts]).astype(np.float64)
    weights = counts / np.maximum(counts.sum(axis=0), 1.0)
    floats: dict[str, NDArray[np.float32]] = {}
    for channel in RGBA:
        floats |= _channel(channel, parts, weights)
    floats |= _layers(parts, counts)
    ordered = {name: floats[name] for name in first.floats}
    return Developed(first.tile, ordered, _integers(parts, counts, floats["Variance.R"]))


def _channel(
    channel: str, parts: Sequence[Developed], weights: NDArray[np.float64]
) -> dict[str, NDArray[np.float32]]:
    means = np.stack([part.floats[channel] for part in parts]).astype(np.float64)
    variances = np.stack([part.floats[f"Variance.{channel}"] for part in parts]).astype(np.float64)
    used = weights > 0
    mean = np.where(used, weights * means, 0.0).sum(axis=0)
    variance = np.where(used, weights**2 * variances, 0.0).sum(axis=0)
    variance = np.where(used.any(axis=0), variance, np.nan)
    return {
        channel: mean.astype(np.float32),
        f"Variance.{channel}": np.minimum(variance, LARGEST).astype(np.float32),
        f"StdErr.{channel}": np.sqrt(variance).astype(np.float32),
    }


def _layers(parts: Sequence[Developed], counts: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    """Plain means over all samples, rejected ones included, as each render has them."""
    rejected = np.stack([part.integers["InvalidCount"] for part in parts])
    weights = counts + rejected
    weights = weights / np.maximum(weights.sum(axis=0), 1.0)
    return {
        name: np.sum([w * part.floats[name] for w, part in zip(weights, parts, strict=True)], axis=0).astype(
            np.float32
        )
        for name in parts[0].floats
        if name in _LAYERS
    }


def _integers(
    parts: Sequence[Developed], counts: NDArray[np.float64], variance: NDArray[np.float32]
) -> dict[str, NDArray[np.uint32]]:
    merged = {
        name: _added([part.integers[name] for part in parts]) for name in ("SampleCount", "InvalidCount")
    }
    given = np.stack([part.integers["Flags"] for part in parts])
    empty = counts == 0
    # A render without a sample in the pixel says nothing of it, but that samples were rejected.
    said = np.where(empty, given & ~np.uint32(flags.EMPTY | _OF_VARIANCE), given)
    bits = np.bitwise_or.reduce(said, axis=0) & ~np.uint32(flags.EMPTY | flags.NO_VARIANCE)
    bits |= np.where(empty.all(axis=0), np.uint32(flags.EMPTY), np.uint32(0))
    bits |= np.where(np.isnan(variance), np.uint32(flags.NO_VARIANCE), np.uint32(0))
    merged["Flags"] = bits
    if "ID" in parts[0].integers:
        merged["ID"] = parts[0].integers["ID"]
    return {name: merged[name] for name in parts[0].integers}


def _added(counts: list[NDArray[np.uint32]]) -> NDArray[np.uint32]:
    total = np.sum(np.stack(counts), axis=0, dtype=np.uint64)
    return np.minimum(total, np.uint64(_MOST)).astype(np.uint32)


def picture_error(bands: Iterable[Developed]) -> tuple[ImageError, float]:
    """The error of a developed picture, and its share of pixels whose error bar is not to be trusted.

    Bands must consist of whole rows of grid.POOL_BLOCK, but for the window's own edges.
    """
    summaries, untrusted = [], 0
    for band in bands:
        summaries.append(_summary(band))
        untrusted += count_untrusted(band.integers["Flags"])
    pixels = sum(summary.all_pixels for summary in summaries)
    return image_error(summaries), untrusted / pixels if pixels else 0.0


def _summary(band: Developed) -> TileSummary:
    mean = _stacked(band, RGBA)
    counts = {name: int(band.integers[name].sum(dtype=np.uint64)) for name in ("SampleCount", "InvalidCount")}
    return TileSummary(
        blocks=block_sums(band.tile, mean, _stacked(band, [f"Variance.{c}" for c in RGBA])),
        all_pixels=band.tile.width * band.tile.height,
        taken=counts["SampleCount"],
        rejected=counts["InvalidCount"],
        maximum=float(mean[..., :3].max(initial=0.0)),
    )


def _stacked(band: Developed, names: Iterable[str]) -> NDArray[np.float64]:
    """(height, width, channels)."""
    return np.stack([band.floats[name] for name in names], axis=-1).astype(np.float64)
