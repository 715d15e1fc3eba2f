"""Cameras look along their own -Z axis, X right, Y up (as in glTF), and are placed by their transform."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from penumbra_scene.base import Float, Model, NonNegative, NotBoolean, Positive, error_at
from penumbra_scene.transforms import Transform


class Lens(Model):
    """A thin lens: what is not at the focus distance blurs."""

    aperture_radius: NonNegative = 0.0
    """Metres; 0 is a pinhole."""
    focus_distance: Positive = 1.0
    """Metres along the optical axis to the plane in focus."""
    blades: Annotated[int, Field(ge=0, le=64), NotBoolean] = 0
    """Sides of the aperture's polygon; 0 is a disc. 1 and 2 are refused."""
    rotation: Float = 0.0
    """Degrees by which the polygon is turned."""

    @model_validator(mode="after")
    def _polygon(self) -> Lens:
        if self.blades in (1, 2):
            raise error_at("/blades", "a polygon has at least 3 sides", "0 (a disc), or 3 to 64")
        return self


class Shutter(Model):
    """When light is gathered, in seconds from the frame's own time."""

    open: Float = 0.0
    close: Float = 0.0
    curve: Annotated[tuple[NonNegative, ...], Field(min_length=2, max_length=64)] = (1.0, 1.0)
    """Opening at equal steps from open to close, linear in between; only its shape matters."""

    @model_validator(mode="after")
    def _valid(self) -> Shutter:
        if self.close < self.open:
            raise error_at("/close", "the shutter closes before it opens", f"at least {self.open} (open)")
        if not any(self.curve):
            raise error_at("/curve", "is zero everywhere", "at least one number above 0")
        return self


class _Camera(Model):
    transform: Transform = ()
    lens: Lens = Lens()
    shutter: Shutter = Shutter()


class PerspectiveCamera(_Camera):
    type: Literal["perspective"]
    fov: Annotated[Positive, Field(lt=180)] = 45.0
    """Degrees, along `fov_axis`."""
    fov_axis: Literal["x", "y", "smaller", "larger"] = "y"


class OrthographicCamera(_Camera):
    type: Literal["orthographic"]
    height: Positive = 2.0
    """Metres of the world that the picture's height shows."""


Camera = Annotated[PerspectiveCamera | OrthographicCamera, Field(discriminator="type")]
