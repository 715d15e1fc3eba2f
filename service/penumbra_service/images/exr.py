"""Writes the EXR: a float part with the picture and its variance, and a uint32 part with the counts.

Bands of scanlines go in as they are developed, so a picture never has to be in memory as a whole. The
file appears under its name only when it is complete. Linear Rec.709; a crop is the data window in the
full frame's display window.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own documentation calls it so
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.images.room import writes_into

PICTURE_PART: Final = "picture"
COUNTS_PART: Final = "counts"
COMPRESSION: Final = "zip"
"""Lossless, and read by everything; blocks of 16 scanlines."""
PICTURE_CHANNELS: Final = frozenset("RGBA")
"""What `half` makes half: variance and layers stay float."""
HALF_LARGEST: Final = 65504.0
REC709: Final = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""xy of red, green, blue and white (ITU-R BT.709), as the standard attribute `chromaticities`."""


class ExrError(OSError):
    """The file cannot be written."""


class Band(Protocol):
    """Whole scanlines of the window: penumbra_service.film.develop.Developed is one."""

    @property
    def tile(self) -> Tile: ...
    @property
    def floats(self) -> dict[str, NDArray[np.float32]]: ...
    @property
    def integers(self) -> dict[str, NDArray[np.uint32]]: ...


@dataclass(frozen=True)
class ExrLayout:
    """What the file holds."""

    window: Tile
    """Rendered pixels, in those of the full frame, row 0 at the top."""
    full_width: int
    full_height: int
    float_channels: Sequence[str]
    integer_channels: Sequence[str]
    half: bool = False
    """Store R G B A as half."""
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)
    """Written into both parts; integers beyond 32 bits are refused, give them as strings."""


def write_exr(path: Path, layout: ExrLayout, bands: Iterable[Band]) -> None:
    """Writes the bands, which come from top to bottom and make up the window. Raises ExrError, ValueError,
    OSError where the disk is full."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}-", suffix=".exr", dir=path.parent)
    os.close(handle)
    try:
        with writes_into(path.parent), tempfile.TemporaryFile(dir=path.parent) as counts:
            _write(Path(name), layout, bands, counts)
        _sync(Path(name))
        Path(name).chmod(0o644)
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)


def _write(path: Path, layout: ExrLayout, bands: Iterable[Band], counts: Any) -> None:
    specs = (_picture_spec(layout), _counts_spec(layout))
    writer = oiio.ImageOutput.create(str(path))
    if writer is None:
        raise ExrError(oiio.geterror())
    _demand(writer.open(str(path), specs), writer)
    _write_picture(writer, layout, bands, counts)
    _demand(writer.open(str(path), specs[1], "AppendSubimage"), writer)
    _write_counts(writer, layout, counts)
    _demand(writer.close(), writer)


def _write_picture(writer: Any, layout: ExrLayout, bands: Iterable[Band], counts: Any) -> None:
    """The float part; the counts of each band wait in a file, since parts are written one after the other."""
    row = layout.window.y
    for band in bands:
        tile = band.tile
        if (tile.x, tile.y, tile.width) != (layout.window.x, row, layout.window.width):
            raise ValueError(f"band {tile} where whole scanlines from row {row} on are due")
        pixels = np.stack([band.floats[name] for name in layout.float_channels], axis=-1, dtype=np.float32)
        if layout.half:
            _fit_half(pixels, layout)
        _demand(writer.write_scanlines(row, row + tile.height, 0, pixels), writer)
        integers = [band.integers[name] for name in layout.integer_channels]
        counts.write(np.stack(integers, axis=-1, dtype=np.uint32).tobytes())
        row += tile.height
    if row != layout.window.y + layout.window.height:
        raise ValueError(f"the bands end at row {row} of {layout.window}")


def _fit_half(pixels: NDArray[np.float32], layout: ExrLayout) -> None:
    """Half floats end at 65504: brighter pixels are stored as that, not as infinity."""
    for i, name in enumerate(layout.float_channels):
        if name in PICTURE_CHANNELS:
            np.clip(pixels[..., i], -HALF_LARGEST, HALF_LARGEST, out=pixels[..., i])


def _write_counts(writer: Any, layout: ExrLayout, counts: Any) -> None:
    counts.seek(0)
    window, channels = layout.window, len(layout.integer_channels)
    for row in range(window.y, window.y + window.height, 64):
        rows = min(64, window.y + window.height - row)
        data = counts.read(rows * window.width * channels * 4)
        pixels = np.frombuffer(data, np.uint32).reshape(rows, window.width, channels)
        _demand(writer.write_scanlines(row, row + rows, 0, pixels), writer)


def _picture_spec(layout: ExrLayout) -> Any:
    spec = _spec(layout, layout.float_channels, oiio.FLOAT, PICTURE_PART)
    if layout.half:
        spec.channelformats = tuple(
            oiio.TypeDesc("half" if name in PICTURE_CHANNELS else "float") for name in layout.float_channels
        )
    spec.alpha_channel = list(layout.float_channels).index("A") if "A" in layout.float_channels else -1
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), REC709)
    return spec


def _counts_spec(layout: ExrLayout) -> Any:
    return _spec(layout, layout.integer_channels, oiio.UINT, COUNTS_PART)


def _spec(layout: ExrLayout, channels: Sequence[str], kind: Any, part: str) -> Any:
    window = layout.window
    spec = oiio.ImageSpec(window.width, window.height, len(channels), kind)
    spec.channelnames = tuple(channels)
    spec.x, spec.y = window.x, window.y
    spec.full_x = spec.full_y = 0
    spec.full_width, spec.full_height = layout.full_width, layout.full_height
    spec.attribute("compression", COMPRESSION)
    spec.attribute("oiio:subimagename", part)
    for name, value in layout.attributes.items():
        if isinstance(value, int) and not -(2**31) <= value < 2**31:
            raise ValueError(f"attribute {name}: {value} has more than 32 bits; give it as a string")
        spec.attribute(name, value)
    return spec


def _demand(good: bool, writer: Any) -> None:
    if not good:
        raise ExrError(writer.geterror() or "OpenImageIO cannot write the file")


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
