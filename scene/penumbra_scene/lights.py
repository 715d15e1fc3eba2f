"""Lights without a body, and the environment. Lights with one are shapes with an `emission`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from penumbra_scene.assets import AssetRef
from penumbra_scene.base import Direction, Model, Name, NonNegative, Positive, Radiance, Vec3, error_at
from penumbra_scene.transforms import Transform


class _Light(Model):
    name: Name | None = None
    transform: Transform = ()


class PointLight(_Light):
    type: Literal["point"]
    position: Vec3 = (0.0, 0.0, 0.0)
    intensity: Radiance = (1.0, 1.0, 1.0)
    """W / sr."""


class SpotLight(_Light):
    type: Literal["spot"]
    position: Vec3 = (0.0, 0.0, 0.0)
    direction: Direction = (0.0, 0.0, -1.0)
    intensity: Radiance = (1.0, 1.0, 1.0)
    """W / sr on the axis."""
    outer_cone_angle: Annotated[Positive, Field(le=180)] = 45.0
    """Degrees from the axis beyond which there is no light (glTF's KHR_lights_punctual, in degrees)."""
    inner_cone_angle: Annotated[NonNegative, Field(le=180)] = 0.0
    """Degrees from the axis within which the light is full; in between it falls off smoothly."""

    @model_validator(mode="after")
    def _cone(self) -> SpotLight:
        if self.inner_cone_angle > self.outer_cone_angle:
            raise error_at("/inner_cone_angle", "exceeds the outer one", f"at most {self.outer_cone_angle:g}")
        return self


class DirectionalLight(_Light):
    type: Literal["directional"]
    direction: Direction = (0.0, -1.0, 0.0)
    """Where the light goes."""
    irradiance: Radiance = (1.0, 1.0, 1.0)
    """W / m^2 on a surface that faces it."""


Light = Annotated[PointLight | SpotLight | DirectionalLight, Field(discriminator="type")]


class ConstantEnvironment(Model):
    type: Literal["constant"]
    radiance: Radiance = (1.0, 1.0, 1.0)
    """W / (m^2 sr) from every direction."""


class ImageEnvironment(Model):
    """A latitude-longitude image: +Y is its top row, -Z its centre column, u grows to the right (east)."""

    type: Literal["image"]
    image: AssetRef
    scale: NonNegative = 1.0
    """Factor on the image's linear values, W / (m^2 sr)."""
    transform: Transform = ()
    """Only its rotation counts."""


Environment = Annotated[ConstantEnvironment | ImageEnvironment, Field(discriminator="type")]
