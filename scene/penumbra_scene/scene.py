"""The scene: everything that determines a picture."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from penumbra_scene import limits
from penumbra_scene.adaptive import Adaptive, in_force
from penumbra_scene.base import Model, Name, NotBoolean
from penumbra_scene.camera import Camera
from penumbra_scene.film import Film
from penumbra_scene.lights import Environment, Light
from penumbra_scene.materials import Material
from penumbra_scene.settings import Integrator, Sampler, Stop
from penumbra_scene.shapes import PrototypeShape, Shape
from penumbra_scene.textures import Texture

Prototype = Annotated[tuple[PrototypeShape, ...], Field(min_length=1, max_length=limits.MAX_SHAPES)]


class Scene(Model, defer_build=False):  # every process needs it, and jobs reuse what is built here
    """Metres, seconds, degrees; right-handed, Y up; linear Rec.709."""

    version: Annotated[Literal[1], NotBoolean]
    """Of this format."""
    name: Name = "untitled"
    camera: Camera
    film: Film = Film()
    integrator: Integrator = Integrator()
    sampler: Sampler = Sampler()
    adaptive: Annotated[Adaptive | None, AfterValidator(in_force)] = None
    """Null: every pixel gets the same number of samples."""
    stop: Stop = Stop()
    textures: Annotated[dict[Name, Texture], Field(max_length=limits.MAX_TEXTURES)] = Field(
        default_factory=dict
    )
    materials: Annotated[dict[Name, Material], Field(max_length=limits.MAX_MATERIALS)] = Field(
        default_factory=dict
    )
    prototypes: Annotated[dict[Name, Prototype], Field(max_length=limits.MAX_PROTOTYPES)] = Field(
        default_factory=dict
    )
    """Groups of shapes, stored once, that instances place."""
    shapes: Annotated[tuple[Shape, ...], Field(max_length=limits.MAX_SHAPES)] = ()
    lights: Annotated[tuple[Light, ...], Field(max_length=limits.MAX_LIGHTS)] = ()
    environment: Environment | None = None
