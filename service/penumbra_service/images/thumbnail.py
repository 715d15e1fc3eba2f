"""The picture as people look at it: exposure, a view transform, 8-bit sRGB. Never of use for measuring."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from penumbra_service.images.png import write_png
from penumbra_service.images.resize import shrink

View = Literal["srgb", "aces"]

ACES_CONFIG: Final = "ocio://cg-config-v1.0.0_aces-v1.3_ocio-v2.1"
"""Built into OpenColorIO, which comes with OpenImageIO; its SDR view is the rendering of ACES 1.0."""
ACES_DISPLAY: Final = "sRGB - Display"
ACES_VIEW: Final = "ACES 1.0 - SDR Video"
ACES_FROM: Final = "Linear Rec.709 (sRGB)"
_LARGEST: Final = 65504.0
"""Brighter is white in either view; beyond half's range the ACES curve is not defined."""


def thumbnail(
    rgb: NDArray[np.float32], *, exposure: float = 0.0, view: View = "srgb", max_side: int = 512
) -> NDArray[np.uint8]:
    """(height, width, 3) sRGB code values from linear Rec.709 (height, width, 3 or more); `exposure` in
    stops."""
    small = shrink(np.nan_to_num(rgb[..., :3], nan=0.0, posinf=_LARGEST, neginf=0.0), max_side)
    # in float64: 2^32 times the largest float32 is one, too
    exposed = np.clip(small.astype(np.float64) * 2.0**exposure, 0.0, _LARGEST).astype(np.float32)
    display = _aces(exposed) if view == "aces" else srgb_encode(exposed)
    return quantize(display)


def write_thumbnail(
    path: Path, rgb: NDArray[np.float32], *, exposure: float = 0.0, view: View = "srgb", max_side: int = 512
) -> None:
    """The same as a PNG file. Raises OSError."""
    pixels = thumbnail(rgb, exposure=exposure, view=view, max_side=max_side)
    write_png(path, pixels, {"Description": f"exposure {exposure:g} stops, view {view}"})


def srgb_encode(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Display values in [0, 1] from linear ones (IEC 61966-2-1)."""
    x = np.clip(linear, 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055
    return np.where(x <= 0.0031308, 12.92 * x, curve).astype(np.float32)


def quantize(display: NDArray[np.float32]) -> NDArray[np.uint8]:
    """8-bit code values, rounded to the nearest."""
    codes: NDArray[np.uint8] = np.rint(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8)
    return codes


def _aces(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    import OpenImageIO as oiio  # noqa: N813 - its own documentation calls it so

    source = oiio.ImageBuf(np.ascontiguousarray(linear))
    shown = oiio.ImageBufAlgo.ociodisplay(
        source, ACES_DISPLAY, ACES_VIEW, fromspace=ACES_FROM, colorconfig=ACES_CONFIG
    )
    if shown.has_error:
        raise OSError(f"the ACES view cannot be made: {shown.geterror()}")
    pixels = shown.get_pixels(oiio.FLOAT)
    if pixels is None:
        raise OSError(f"the ACES view cannot be made: {shown.geterror()}")
    return np.asarray(pixels, np.float32)
