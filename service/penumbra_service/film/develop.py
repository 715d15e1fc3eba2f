"""From sums to the EXR's channels: float32 pictures and uint32 counts, tile by tile or band by band.

Channels of the float part: R G B A, Variance.* (of the mean), StdErr.*, and with layers Albedo.R/G/B,
N.X/Y/Z, Z. Of the uint32 part: SampleCount, InvalidCount, Flags (see flags.py) and, with layers, ID (1 +
index of the shape that the first sample hit, 0 for none). All linear Rec.709, metres, world frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film.film import Film
from penumbra_service.film.statistics import LARGEST, PixelStatistics, pixel_flags, pixel_statistics

RGBA: Final = ("R", "G", "B", "A")
LAYER_CHANNELS: Final[dict[str, tuple[str, ...]]] = {
    "albedo": ("Albedo.R", "Albedo.G", "Albedo.B"),
    "normal": ("N.X", "N.Y", "N.Z"),
    "depth": ("Z",),
}
"""Channels of each layer that a scene may ask for."""


@dataclass(frozen=True)
class Developed:
    """Channels of a rectangle of the full frame, each (height, width)."""

    tile: Tile
    floats: dict[str, NDArray[np.float32]]
    integers: dict[str, NDArray[np.uint32]]


def float_channels(layers: tuple[str, ...] = ()) -> list[str]:
    """Names in the order in which `develop` gives them."""
    names = [*RGBA, *(f"Variance.{c}" for c in RGBA), *(f"StdErr.{c}" for c in RGBA)]
    for layer in LAYER_CHANNELS:
        if layer in layers:
            names += LAYER_CHANNELS[layer]
    return names


def integer_channels(layers: tuple[str, ...] = ()) -> list[str]:
    """Names in the order in which `develop` gives them."""
    return ["SampleCount", "InvalidCount", "Flags", *(["ID"] if layers else [])]


def develop(film: Film, end: int, layers: tuple[str, ...] = ()) -> Iterator[Developed]:
    """Every tile of the window, row by row, from samples [0, end) of each replicate."""
    for tile in film.tiles:
        yield develop_tile(film, tile, end, layers)


def develop_bands(film: Film, end: int, layers: tuple[str, ...] = ()) -> Iterator[Developed]:
    """The window as bands over its whole width, top to bottom: for writers that want scanlines."""
    for row in film.grid.rows:
        parts = [develop_tile(film, tile, end, layers) for tile in film.grid.row(row)]
        first = parts[0].tile
        band = Tile(first.x, first.y, film.grid.window.width, first.height)
        floats = {name: np.concatenate([p.floats[name] for p in parts], axis=1) for name in parts[0].floats}
        integers = {
            name: np.concatenate([p.integers[name] for p in parts], axis=1) for name in parts[0].integers
        }
        yield Developed(band, floats, integers)


def develop_tile(film: Film, tile: Tile, end: int, layers: tuple[str, ...] = ()) -> Developed:
    """One tile. Raises ValueError where samples of [0, end) are missing."""
    sums = film.accumulator(tile)
    pixels = pixel_statistics(tile, sums.fold(end), deterministic=film.deterministic)
    floats = _picture(pixels)
    integers = {
        "SampleCount": pixels.taken.astype(np.uint32),
        "InvalidCount": pixels.rejected.astype(np.uint32),
        "Flags": pixel_flags(pixels, deterministic=film.deterministic),
    }
    layer_sums = sums.fold_layers(end) if layers else None
    if layer_sums is not None:
        floats |= _layers(layer_sums, pixels, layers)
        integers["ID"] = layer_sums["object_id"][0].copy()
    return Developed(tile, floats, integers)


def _picture(pixels: PixelStatistics) -> dict[str, NDArray[np.float32]]:
    floats = {c: pixels.mean[..., i].astype(np.float32) for i, c in enumerate(RGBA)}
    # Squared radiance can pass float32's range: its largest number then stands there, never infinity.
    variance = np.minimum(pixels.variance, LARGEST)
    floats |= {f"Variance.{c}": variance[..., i].astype(np.float32) for i, c in enumerate(RGBA)}
    # The root of the float64 variance: a variance below float32's range may have a standard error within it.
    floats |= {f"StdErr.{c}": np.sqrt(pixels.variance[..., i]).astype(np.float32) for i, c in enumerate(RGBA)}
    return floats


def _layers(
    sums: NDArray[Any], pixels: PixelStatistics, layers: tuple[str, ...]
) -> dict[str, NDArray[np.float32]]:
    """Means over all samples, rejected ones included: those too had a first hit."""
    count = np.maximum(pixels.taken + pixels.rejected, 1).astype(np.float64)[..., None]
    albedo_depth = sums["albedo_depth"].sum(axis=0, dtype=np.float64) / count
    normal = sums["normal"].sum(axis=0, dtype=np.float64) / count
    values = {"albedo": albedo_depth[..., :3], "normal": normal, "depth": albedo_depth[..., 3:]}
    floats: dict[str, NDArray[np.float32]] = {}
    for layer, names in LAYER_CHANNELS.items():
        if layer in layers:
            floats |= {name: values[layer][..., i].astype(np.float32) for i, name in enumerate(names)}
    return floats
