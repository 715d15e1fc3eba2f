"""Where a picture is how noisy: relative standard error as colour, on a scale that is the same for every job.

The value of a pixel is sqrt(mean of V) / sqrt(mean of m^2 + 0.01) over R, G and B, with V the variance of
the mean m: the relative error that stop rules use, of a single pixel. The scale is logarithmic, from 0.1
% to 100 %, and is drawn below the picture. Gray means that the error is not known.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from penumbra_service.images.digits import draw_text
from penumbra_service.images.png import write_png
from penumbra_service.images.resize import shrink
from penumbra_service.images.thumbnail import quantize, srgb_encode

LOWEST: Final = 1e-3
HIGHEST: Final = 1.0
EPSILON: Final = 0.01
"""The same as in relmse: errors of dark pixels are relative to at least 0.1."""
UNKNOWN: Final = np.array([96, 96, 96], np.uint8)
SCALE_HEIGHT: Final = 20
"""Pixels of the scale below the picture: a bar, and its labels."""
_BAR_HEIGHT: Final = 8
_LABELS: Final = ((1e-3, "0.1%"), (1e-2, "1%"), (1e-1, "10%"), (1.0, "100%"))
_SMALLEST_WITH_SCALE: Final = 96
"""Pixels of width below which labels would overlap."""


def relative_error(mean: NDArray[np.float32], variance: NDArray[np.float32]) -> NDArray[np.float64]:
    """(height, width), NaN where variance is; from (height, width, 3 or more) each."""
    m = mean[..., :3].astype(np.float64)
    v = variance[..., :3].astype(np.float64)
    quotient: NDArray[np.float64] = np.sqrt(v.mean(axis=-1) / ((m * m).mean(axis=-1) + EPSILON))
    return quotient


def heatmap(
    mean: NDArray[np.float32], variance: NDArray[np.float32], *, max_side: int = 512
) -> NDArray[np.uint8]:
    """(height + SCALE_HEIGHT, width, 3) sRGB code values; no side is above `max_side`."""
    room = SCALE_HEIGHT if max_side > 4 * SCALE_HEIGHT else 0
    both = np.concatenate((mean[..., :3], variance[..., :3]), axis=-1)
    # the error of a typical pixel within, not that of their average
    small = shrink(both.astype(np.float32), max_side - room)
    picture = _colored(relative_error(small[..., :3], small[..., 3:]))
    if room == 0 or picture.shape[1] < _SMALLEST_WITH_SCALE:
        return picture
    return np.concatenate((picture, _scale(picture.shape[1])))


def write_heatmap(
    path: Path, mean: NDArray[np.float32], variance: NDArray[np.float32], *, max_side: int = 512
) -> None:
    """The same as a PNG file. Raises OSError."""
    text = "relative standard error, logarithmic from 0.1 % (dark) to 100 % (light); gray: not known"
    write_png(path, heatmap(mean, variance, max_side=max_side), {"Description": text})


def _colored(error: NDArray[np.float64]) -> NDArray[np.uint8]:
    known = np.isfinite(error)
    position = np.log(np.clip(np.where(known, error, LOWEST), LOWEST, HIGHEST) / LOWEST) / np.log(
        HIGHEST / LOWEST
    )
    colors = palette(position)
    colors[~known] = UNKNOWN
    return colors


def palette(position: NDArray[np.float64]) -> NDArray[np.uint8]:
    """sRGB code values (..., 3) for positions in [0, 1]: lightness rises evenly while the hue turns from
    blue to yellow.

    Made in OKLab (Ottosson 2020, 'A perceptual color space for image processing'), where equal steps look
    equal.
    """
    lightness = 0.15 + 0.80 * position
    hue = np.deg2rad(280.0 - 530.0 / 3.0 * position)
    chroma = 0.02 + 0.13 * np.sin(np.pi * np.clip(0.1 + 0.8 * position, 0.0, 1.0))
    return quantize(srgb_encode(_linear_from_oklab(lightness, chroma * np.cos(hue), chroma * np.sin(hue))))


def _linear_from_oklab(
    lightness: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Linear Rec.709 (..., 3), not yet inside the gamut."""
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    medium = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    return np.stack(
        (
            4.0767416621 * long - 3.3077115913 * medium + 0.2309699292 * short,
            -1.2684380046 * long + 2.6097574011 * medium - 0.3413193965 * short,
            -0.0041960863 * long - 0.7034186147 * medium + 1.7076147010 * short,
        ),
        axis=-1,
    ).astype(np.float32)


def _scale(width: int) -> NDArray[np.uint8]:
    """The bar of colours with its labels, (SCALE_HEIGHT, width, 3)."""
    strip = np.zeros((SCALE_HEIGHT, width, 3), np.uint8)
    strip[2 : 2 + _BAR_HEIGHT] = palette(np.linspace(0.0, 1.0, width))
    for value, label in _LABELS:
        at = round(np.log(value / LOWEST) / np.log(HIGHEST / LOWEST) * (width - 1))
        draw_text(strip, label, at, _BAR_HEIGHT + 5)
    return strip
