"""Reads images by OpenImageIO, as they are stored. Runs in the decoding process: the file may be hostile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own documentation calls it so
from numpy.typing import NDArray
from penumbra_kernels.assets import AssetError, Image

from penumbra_service.images.limits import DecodeLimits


def read_image(path: Path, limits: DecodeLimits) -> Image:
    """The first image of the file. Raises AssetError."""
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # colours as stored, not multiplied by alpha
    reader = oiio.ImageInput.open(str(path), config)
    if reader is None:
        raise AssetError(oiio.geterror() or "it cannot be opened as an image")
    try:
        spec = reader.spec()
        _check_size(spec, limits)
        channels = _color_channels(spec)
        pixels = reader.read_image(0, 0, 0, spec.nchannels, oiio.FLOAT)
        if pixels is None:
            raise AssetError(reader.geterror() or "its pixels cannot be read")
        return Image(_rgb(pixels, channels), spec.format == oiio.TypeDesc("uint8"))
    finally:
        reader.close()


def _check_size(spec: Any, limits: DecodeLimits) -> None:
    width, height = spec.width, spec.height
    if spec.depth > 1:
        raise AssetError("volumes are not accepted, only flat images")
    if width < 1 or height < 1:
        raise AssetError(f"an image needs pixels; this has {width} x {height}")
    if max(width, height) > limits.side or width * height > limits.pixels:
        raise AssetError(
            f"the image has {width} x {height} pixels; accepted: sides of at most {limits.side}, "
            f"at most {limits.pixels} pixels in all"
        )


def _color_channels(spec: Any) -> tuple[int, int, int]:
    """Where red, green and blue are; a gray image has one channel for all three."""
    names = [str(name).lower() for name in spec.channelnames]
    if all(name in names for name in "rgb"):
        return names.index("r"), names.index("g"), names.index("b")
    return (0, 1, 2) if spec.nchannels >= 3 else (0, 0, 0)


def _rgb(pixels: NDArray[np.float32], channels: tuple[int, int, int]) -> NDArray[np.float32]:
    rgb = np.ascontiguousarray(pixels[:, :, list(channels)], np.float32)
    finite = np.isfinite(rgb)
    if not finite.all():
        y, x = (int(i) for i in np.argwhere(~finite.all(axis=2))[0])
        raise AssetError(
            f"pixels must be finite; column {x}, row {y} (from the top) has {rgb[y, x].tolist()}"
        )
    return rgb
