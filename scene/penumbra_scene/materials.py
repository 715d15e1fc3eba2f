"""Materials, by name. Roughness is perceptual as in glTF and OpenPBR: alpha = roughness^2."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from penumbra_scene.base import Bool, Float, Model, Name, Positive, Reflectance, Unit, error_at


class TextureRef(Model):
    texture: Name
    """A name under the scene's `textures`."""


def _color_tag(value: Any) -> str:
    return "texture" if isinstance(value, (dict, TextureRef)) else "color"


Color = Annotated[
    Annotated[Reflectance, Tag("color")] | Annotated[TextureRef, Tag("texture")], Discriminator(_color_tag)
]
"""A reflectance, or {"texture": name}."""

Ior = Annotated[Positive, Field(ge=0.1, le=10)]


class _Material(Model):
    """What every material has: nothing yet."""


class _Rough(_Material):
    roughness: Unit = 0.3
    """0 is a perfect mirror or a clear pane, and so is what lies below some 0.01: lobes narrower than that are
    lost in rounding."""
    anisotropy: Annotated[Float, Field(ge=0, le=1)] = 0.0
    """OpenPBR's specular_roughness_anisotropy: stretches highlights along the tangent."""
    rotation: Float = 0.0
    """Degrees by which the tangent is turned about the normal."""
    energy_compensation: Bool = True
    """Give back the light that single scattering on rough microfacets loses (Kulla and Conty 2017)."""


class Diffuse(_Material):
    """Lambertian reflection."""

    type: Literal["diffuse"]
    base_color: Color = (0.8, 0.8, 0.8)


class Phong(_Material):
    """Lambertian base with a Phong cone about the mirror direction (Lafortune and Willems 1994)."""

    type: Literal["phong"]
    base_color: Color = (0.5, 0.5, 0.5)
    specular_color: Color = (0.3, 0.3, 0.3)
    exponent: Annotated[Float, Field(ge=0, le=1e6)] = 30.0


class Mirror(_Material):
    """A perfect mirror."""

    type: Literal["mirror"]
    color: Color = (1.0, 1.0, 1.0)


class Conductor(_Rough):
    """A metal: GGX microfacets, Schlick's Fresnel between base_color (F0) and white."""

    type: Literal["conductor"]
    base_color: Color = (0.9, 0.9, 0.9)
    fresnel: Bool = True
    """False keeps base_color at every angle."""


class Plastic(_Rough):
    """A diffuse base under a dielectric coat of GGX microfacets."""

    type: Literal["plastic"]
    base_color: Color = (0.5, 0.5, 0.5)
    ior: Ior = 1.5


class Dielectric(_Rough):
    """Glass, water: GGX microfacets that reflect and refract (Walter et al. 2007); normals point outwards."""

    type: Literal["dielectric"]
    roughness: Unit = 0.0
    ior: Ior = 1.5
    color: Color = (1.0, 1.0, 1.0)
    """What a crossing of the surface transmits."""


class ThinDielectric(_Material):
    """A thin sheet with two parallel faces: light passes without being bent, inter-reflections summed."""

    type: Literal["thin_dielectric"]
    ior: Ior = 1.5
    color: Color = (1.0, 1.0, 1.0)
    roughness: Unit = 0.0
    """Above zero both the reflected and the transmitted lobe blur."""


class DiffuseTransmission(_Material):
    """Paper, leaves, lampshades: Lambertian on both sides."""

    type: Literal["diffuse_transmission"]
    reflectance: Color = (0.4, 0.4, 0.4)
    transmittance: Color = (0.4, 0.4, 0.4)
    """reflectance + transmittance must not exceed 1 in any channel (textures are scaled down there)."""

    @model_validator(mode="after")
    def _conserves_energy(self) -> DiffuseTransmission:
        if isinstance(self.reflectance, TextureRef) or isinstance(self.transmittance, TextureRef):
            return self
        # The slack is for decimals such as 0.3 + 0.7, whose doubles may add up to one ulp above 1.
        if any(r + t > 1 + 1e-12 for r, t in zip(self.reflectance, self.transmittance, strict=True)):
            raise error_at("/transmittance", "reflectance + transmittance exceeds 1", "sums of at most 1")
        return self


Material = Annotated[
    Diffuse | Phong | Mirror | Conductor | Plastic | Dielectric | ThinDielectric | DiffuseTransmission,
    Field(discriminator="type"),
]

__all__ = [
    "Color",
    "Conductor",
    "Dielectric",
    "Diffuse",
    "DiffuseTransmission",
    "Material",
    "Mirror",
    "Phong",
    "Plastic",
    "TextureRef",
    "ThinDielectric",
]
