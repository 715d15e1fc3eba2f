"""Environment images: texels, and the distribution that light samples follow (cl/lights/environment.cl).

Latitude-longitude, row 0 at +Y; radiance in W / (m^2 sr), linear Rec.709. Everything is built in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene import limits
from penumbra_scene.lights import ImageEnvironment

from penumbra_kernels.assets import AssetError, Assets
from penumbra_kernels.compile.alias import STEPS, quantised_cdf
from penumbra_kernels.compile.textures import srgb_to_linear
from penumbra_kernels.compile.transforms import poses_of

ROWS_AT_ONCE: Final = 256
"""Rows that are worked on in float64 together, to bound memory."""


@dataclass(frozen=True)
class CompiledEnvironment:
    """One image environment."""

    buffer: NDArray[np.float32]
    """(n, 4): the texels, then the CDFs, padded."""
    width: int
    height: int
    first_cdf: int
    """Index of the rows' CDF among the buffer's floats."""
    flux: float
    """Integral over the sphere of the mean of red, green and blue, W / m^2."""
    environment_from_world: NDArray[np.float64]
    """(3, 3) rotation."""


def row_solid_angles(height: int) -> NDArray[np.float64]:
    """(height,) solid angle of each row of the sphere, sr."""
    middle = (np.arange(height) + 0.5) * np.pi / height
    return np.asarray(4.0 * np.pi * np.sin(middle) * np.sin(0.5 * np.pi / height))


def texel_means(gray: NDArray[np.float64]) -> NDArray[np.float64]:
    """(h, w) mean over each texel of the bilinear image of `gray` (h + 2, w), a row more at each end.

    Between texel centres the image is linear: the mean over a texel is 1/8, 6/8, 1/8 of its neighbours.
    """
    across = 0.75 * gray + 0.125 * (np.roll(gray, 1, axis=1) + np.roll(gray, -1, axis=1))
    return np.asarray(0.75 * across[1:-1] + 0.125 * (across[:-2] + across[2:]))


def _pixels(environment: ImageEnvironment, assets: Assets) -> NDArray[np.float32]:
    """(h, w, 3) linear values; filters of high dynamic range leave negative ones, which count as none."""
    image = assets.image(environment.image)
    pixels = srgb_to_linear(image.pixels) if image.eight_bit else image.pixels
    name = environment.image.asset or environment.image.file
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
        raise AssetError(f"image {name} has shape {pixels.shape}; accepted is (height, width, 3), not empty")
    if max(pixels.shape) > limits.MAX_TEXTURE_SIDE:
        raise AssetError(
            f"image {name} is {pixels.shape[1]} x {pixels.shape[0]};"
            f" accepted are sides of up to {limits.MAX_TEXTURE_SIDE}"
        )
    broken = int(np.count_nonzero(~np.isfinite(pixels)))
    if broken:
        raise AssetError(f"image {name} has {broken} values that are NaN or infinite; accepted are finite")
    return np.maximum(pixels, np.float32(0.0))


def compile_environment(environment: ImageEnvironment, assets: Assets, time: float) -> CompiledEnvironment:
    """Texels and CDFs of an image environment, turned as its transform says at `time` seconds.

    Raises AssetError for an image that is missing, empty, too large, or has values that are not finite.
    """
    pixels = _pixels(environment, assets)
    height, width = pixels.shape[:2]
    texels = height * width
    first_cdf = 4 * texels
    floats = first_cdf + (height + 1) + height * (width + 1)
    buffer = np.zeros((-(-floats // 4), 4), np.float32)
    buffer[:texels, :3] = pixels.reshape(-1, 3) * np.float32(environment.scale)
    rows = _fill_columns(buffer, height, width)
    flux = float(rows.sum())
    row_steps = quantised_cdf(rows)
    flat = buffer.reshape(-1)
    flat[first_cdf : first_cdf + height + 1] = row_steps / STEPS
    buffer[:texels, 3].reshape(height, width)[...] *= (np.diff(row_steps) / STEPS * height)[:, None]
    rotation = _rotation(environment, time)
    return CompiledEnvironment(buffer, width, height, first_cdf, flux, rotation.T)


def _fill_columns(buffer: NDArray[np.float32], height: int, width: int) -> NDArray[np.float64]:
    """Writes each row's CDF, and its texels' densities along u after their colours. Returns rows' flux."""
    texels = height * width
    flat = buffer.reshape(-1)
    first = 4 * texels + height + 1
    cdfs = flat[first : first + height * (width + 1)].reshape(height, width + 1)
    density = buffer[:texels, 3].reshape(height, width)
    radiance = buffer[:texels, :3].reshape(height, width, 3)
    solid_angles = row_solid_angles(height)
    flux = np.zeros(height)
    for begin in range(0, height, ROWS_AT_ONCE):
        end = min(begin + ROWS_AT_ONCE, height)
        around = np.clip(np.arange(begin - 1, end + 1), 0, height - 1)
        means = texel_means(radiance[around].astype(np.float64).mean(axis=2))
        flux[begin:end] = means.mean(axis=1) * solid_angles[begin:end]
        steps = quantised_cdf(means)
        cdfs[begin:end] = steps / STEPS
        density[begin:end] = np.diff(steps, axis=1) * (width / STEPS)
    return flux


def _rotation(environment: ImageEnvironment, time: float) -> NDArray[Any]:
    """(3, 3) world-from-environment: the rotation alone of the transform at the frame's time."""
    pose = poses_of(environment.transform, time, time)[0]
    x, y, z, w = pose.rotation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
