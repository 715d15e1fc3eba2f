"""Textures and the images behind them -> TEXTURE records and float4 texels, linear Rec.709 in [0, 1]."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene import limits
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene
from penumbra_scene.textures import CheckerTexture, ConstantTexture, ImageTexture

from penumbra_kernels.assets import AssetError, Assets, Image
from penumbra_kernels.layout import CONSTANTS, TEXTURE

WRAPS: Final = {"repeat": 0, "mirror": 1, "clamp": 2}
_WRAP_SHIFT: Final = 1


def srgb_to_linear(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The sRGB transfer function removed (IEC 61966-2-1), element by element, for values in [0, 1]."""
    wide = values.astype(np.float64)
    return np.where(wide <= 0.04045, wide / 12.92, ((wide + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _name(ref: AssetRef) -> str:
    return ref.asset or ref.file or ""


def _check(image: Image, ref: AssetRef) -> None:
    pixels = image.pixels
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
        raise AssetError(
            f"image {_name(ref)} has shape {pixels.shape}; accepted is (height, width, 3), not empty"
        )
    height, width = pixels.shape[:2]
    if max(height, width) > limits.MAX_TEXTURE_SIDE:
        raise AssetError(
            f"image {_name(ref)} is {width} x {height}; accepted are sides of up to {limits.MAX_TEXTURE_SIDE}"
        )
    broken = int(np.count_nonzero(~np.isfinite(pixels)))
    if broken:
        raise AssetError(
            f"image {_name(ref)} has {broken} values that are NaN or infinite; accepted are finite"
        )


def _texels(image: Image, srgb: bool) -> NDArray[np.float32]:
    """(height * width, 4), rows from the top: linear, clipped to [0, 1] so that no surface makes light."""
    clipped = np.clip(image.pixels, 0.0, 1.0)
    linear = srgb_to_linear(clipped) if srgb else clipped.astype(np.float32)
    texels = np.zeros((linear.shape[0] * linear.shape[1], 4), np.float32)
    texels[:, :3] = linear.reshape(-1, 3)
    return texels


class _Texels:
    """Texels of all images, each decoded image once however often it is named."""

    def __init__(self, assets: Assets) -> None:
        self._assets = assets
        self._blocks: list[NDArray[np.float32]] = []
        self._places: dict[tuple[str, bool], tuple[int, int, int]] = {}
        self._images: dict[str, Image] = {}
        self._count = 0

    def place(self, texture: ImageTexture) -> tuple[int, int, int]:
        """(first texel, width, height) of a texture's image."""
        name = _name(texture.image)
        image = self._image(texture.image)
        srgb = texture.encoding == "srgb" or (texture.encoding == "auto" and image.eight_bit)
        if (name, srgb) not in self._places:
            self._places[name, srgb] = self._append(image, srgb)
        return self._places[name, srgb]

    def _image(self, ref: AssetRef) -> Image:
        name = _name(ref)
        if name not in self._images:
            image = self._assets.image(ref)
            _check(image, ref)
            self._images[name] = image
        return self._images[name]

    def _append(self, image: Image, srgb: bool) -> tuple[int, int, int]:
        first = self._count
        height, width = image.pixels.shape[:2]
        self._count += width * height
        if self._count > limits.MAX_TEXELS:
            raise AssetError(
                f"with it the scene's images have {self._count} pixels; accepted are {limits.MAX_TEXELS}"
            )
        self._blocks.append(_texels(image, srgb))
        return first, width, height

    def array(self) -> NDArray[np.float32]:
        return np.concatenate(self._blocks) if self._blocks else np.zeros((0, 4), np.float32)


def _record(texture: ConstantTexture | CheckerTexture | ImageTexture, texels: _Texels) -> NDArray[Any]:
    record = np.zeros((), TEXTURE)
    record["uv_scale"] = 1.0
    if isinstance(texture, ConstantTexture):
        record["type"] = CONSTANTS["TEXTURE_CONSTANT"]
        record["color0"] = texture.color
        return record
    record["uv_scale"] = texture.uv.scale
    record["uv_offset"] = texture.uv.offset
    if isinstance(texture, CheckerTexture):
        record["type"] = CONSTANTS["TEXTURE_CHECKER"]
        record["color0"], record["color1"] = texture.color0, texture.color1
        return record
    record["type"] = CONSTANTS["TEXTURE_IMAGE"]
    bilinear = CONSTANTS["TEXTURE_BILINEAR"] if texture.filter == "bilinear" else 0
    record["flags"] = bilinear | WRAPS[texture.wrap] << _WRAP_SHIFT
    record["first_texel"], record["width"], record["height"] = texels.place(texture)
    return record


def compile_textures(
    scene: Scene, assets: Assets
) -> tuple[NDArray[Any], NDArray[np.float32], dict[str, int]]:
    """(TEXTURE records, texels (n, 4) float32, name -> index).

    Raises AssetError, naming the texture, for images that are missing, broken or too large.
    """
    texels = _Texels(assets)
    records = np.zeros(len(scene.textures), TEXTURE)
    index: dict[str, int] = {}
    for i, (name, texture) in enumerate(scene.textures.items()):
        try:
            records[i] = _record(texture, texels)
        except AssetError as error:
            raise AssetError(f"/textures/{name}: {error}") from error
        index[name] = i
    return records, texels.array(), index
