"""The film: resolution, crop, reconstruction filter, layers, and how a thumbnail is developed."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from penumbra_scene import limits
from penumbra_scene.base import Bool, Float, Model, NotBoolean, Positive, error_at

Side = Annotated[int, Field(ge=1, le=limits.MAX_RESOLUTION), NotBoolean]


class BoxFilter(Model):
    type: Literal["box"]
    radius: Annotated[Positive, Field(le=16)] = 0.5
    """Pixels; every filter is zero beyond its radius in x or y."""


class TentFilter(Model):
    type: Literal["tent"]
    radius: Annotated[Positive, Field(le=16)] = 1.0


class GaussianFilter(Model):
    type: Literal["gaussian"]
    radius: Annotated[Positive, Field(le=16)] = 1.5
    stddev: Annotated[Positive, Field(le=16)] = 0.5


class MitchellFilter(Model):
    type: Literal["mitchell"]
    radius: Annotated[Positive, Field(le=16)] = 2.0
    b: Annotated[Float, Field(ge=0, le=1)] = 1 / 3
    c: Annotated[Float, Field(ge=0, le=1)] = 1 / 3


class BlackmanHarrisFilter(Model):
    type: Literal["blackman_harris"]
    radius: Annotated[Positive, Field(le=16)] = 1.5


Filter = Annotated[
    BoxFilter | TentFilter | GaussianFilter | MitchellFilter | BlackmanHarrisFilter,
    Field(discriminator="type"),
]


class Crop(Model):
    """A window of pixels; the finished EXR holds it as its data window. Its bits equal the full frame's, but for
    the `block` flag of 8x8 blocks that it cuts."""

    x: Annotated[int, Field(ge=0), NotBoolean]
    y: Annotated[int, Field(ge=0), NotBoolean]
    width: Side
    height: Side


class Thumbnail(Model):
    """How linear radiance becomes the PNG that people look at. The EXR never changes with it."""

    exposure: Annotated[Float, Field(ge=-32, le=32)] = 0.0
    """Stops."""
    view: Literal["srgb", "aces"] = "srgb"
    """A named view transform: plain sRGB, or the ACES 1.0 SDR video rendering."""
    max_side: Annotated[int, Field(ge=16, le=4096), NotBoolean] = 512
    """Pixels of the longer side."""


class Film(Model):
    width: Side = 512
    height: Side = 512
    crop: Crop | None = None
    filter: Filter = BoxFilter(type="box")
    layers: Annotated[tuple[Literal["albedo", "normal", "depth"], ...], Field(max_length=3)] = ()
    """Layers of the first hit that the EXR carries besides the picture."""
    half: Bool = False
    """Store the picture's own R G B A as half floats; variance stays float."""
    thumbnail: Thumbnail = Thumbnail()

    @model_validator(mode="after")
    def _fits(self) -> Film:
        if self.width * self.height > limits.MAX_PIXELS and self.crop is None:
            raise error_at(
                "",
                f"{self.width * self.height} pixels are too many",
                f"width * height at most {limits.MAX_PIXELS}, or a crop",
            )
        if self.crop is not None:
            c = self.crop
            if c.x + c.width > self.width or c.y + c.height > self.height:
                raise error_at("/crop", "leaves the picture", f"a window in {self.width} x {self.height}")
            if c.width * c.height > limits.MAX_PIXELS:
                raise error_at("/crop", "has too many pixels", f"at most {limits.MAX_PIXELS} pixels")
        if len(set(self.layers)) != len(self.layers):
            raise error_at("/layers", "a layer is listed twice", "each of albedo, normal, depth once at most")
        return self

    @property
    def window(self) -> Crop:
        """The pixels that are really rendered."""
        return self.crop or Crop(x=0, y=0, width=self.width, height=self.height)
