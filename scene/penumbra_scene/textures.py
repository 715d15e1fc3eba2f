"""Textures, by name: what a colour can be besides three numbers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from penumbra_scene.assets import AssetRef
from penumbra_scene.base import Model, Reflectance, Vec2


class UvTransform(Model):
    """uv' = uv * scale + offset."""

    scale: Vec2 = (1.0, 1.0)
    offset: Vec2 = (0.0, 0.0)


class ConstantTexture(Model):
    type: Literal["constant"]
    color: Reflectance


class CheckerTexture(Model):
    """Squares of side 1/2 in uv', so that one period of each colour fits a unit of uv' (as in Mitsuba)."""

    type: Literal["checker"]
    color0: Reflectance = (0.4, 0.4, 0.4)
    color1: Reflectance = (0.2, 0.2, 0.2)
    uv: UvTransform = UvTransform()


class ImageTexture(Model):
    type: Literal["image"]
    image: AssetRef
    encoding: Literal["auto", "srgb", "linear"] = "auto"
    """auto: 8-bit images are sRGB, all others linear."""
    filter: Literal["nearest", "bilinear"] = "bilinear"
    wrap: Literal["repeat", "mirror", "clamp"] = "repeat"
    uv: UvTransform = UvTransform()


Texture = Annotated[ConstantTexture | CheckerTexture | ImageTexture, Field(discriminator="type")]
