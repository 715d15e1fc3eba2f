"""Materials -> MATERIAL records, and the albedo tables that they point into."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene import limits
from penumbra_scene.materials import (
    Color,
    Conductor,
    Dielectric,
    Diffuse,
    DiffuseTransmission,
    Material,
    Mirror,
    Phong,
    Plastic,
    TextureRef,
    ThinDielectric,
)
from penumbra_scene.scene import Scene
from penumbra_scene.textures import ConstantTexture

from penumbra_kernels.compile import albedo
from penumbra_kernels.layout import CONSTANTS, MATERIAL

NONE: Final = CONSTANTS["NONE"]

DEFAULT_MATERIAL: Final = 0
"""Index of the gray diffuse material of shapes that name none."""
BLACK_MATERIAL: Final = 1
"""Index of the material of emitters that name none."""
DEFAULT_GRAY: Final = 0.8

ALPHA_MIN: Final = 1e-4
"""Narrower lobes (roughness below .01) are perfect mirrors. At this width the rounding of unit directions,
2^-24 a component, moves a half vector by some 1e-3 of the lobe, and so its density by some 1e-3; ten times
narrower it would be a hundredth."""


def alphas(roughness: float, anisotropy: float) -> tuple[float, float]:
    """GGX widths along and across the tangent, (0, 0) for a perfect mirror.

    OpenPBR 1.1, "Microfacet model": alpha_t = r^2 sqrt(2 / (1 + (1 - a)^2)), alpha_b = (1 - a) alpha_t.
    """
    along = roughness**2 * math.sqrt(2.0 / (1.0 + (1.0 - anisotropy) ** 2))
    if along < ALPHA_MIN:
        return 0.0, 0.0
    return float(np.float32(along)), float(np.float32(max((1.0 - anisotropy) * along, ALPHA_MIN)))


class MaterialError(ValueError):
    """A scene's materials are more than can be prepared; the message says how many are accepted."""


def _color(
    scene: Scene, color: Color, texture_index: dict[str, int]
) -> tuple[tuple[float, float, float], int]:
    """(colour, texture or NONE); constant textures become colours, so that they cost nothing."""
    if not isinstance(color, TextureRef):
        return color, NONE
    texture = scene.textures[color.texture]
    if isinstance(texture, ConstantTexture):
        return texture.color, NONE
    return (0.0, 0.0, 0.0), texture_index[color.texture]


def _blank(kind: str) -> NDArray[Any]:
    record = np.zeros((), MATERIAL)
    record["type"] = CONSTANTS[f"MATERIAL_{kind.upper()}"]
    record["texture0"] = record["texture1"] = record["albedo"] = NONE
    record["ior"] = 1.0
    return record


def _colors(material: Material) -> tuple[Color, Color]:
    """What goes into color0 and color1."""
    black = (0.0, 0.0, 0.0)
    match material:
        case Phong():
            return material.base_color, material.specular_color
        case Mirror():
            return material.color, black
        case Dielectric() | ThinDielectric():
            return (1.0, 1.0, 1.0), material.color
        case DiffuseTransmission():
            return material.reflectance, material.transmittance
        case Diffuse() | Conductor() | Plastic():
            return material.base_color, black


Microfacets = Conductor | Plastic | Dielectric | ThinDielectric


def widths(material: Microfacets) -> tuple[float, float]:
    """GGX widths along and across the tangent, (0, 0) where the lobe is a delta."""
    ax, ay = alphas(material.roughness, 0.0 if isinstance(material, ThinDielectric) else material.anisotropy)
    if isinstance(material, Dielectric) and abs(material.ior - 1.0) * ax < ALPHA_MIN:
        # Refraction turns rays by |ior - 1| times the microfacet's slope: below ALPHA_MIN the pane is clear.
        return 0.0, 0.0
    return ax, ay


def has_delta_lobe(material: Material) -> bool:
    """Whether the material sends some light on in one direction alone."""
    return isinstance(material, Mirror) or (isinstance(material, Microfacets) and widths(material)[0] == 0.0)


def _set_roughness(record: NDArray[Any], material: Microfacets) -> None:
    ax, ay = widths(material)
    if isinstance(material, ThinDielectric):
        rotation, compensate = 0.0, True
    else:
        rotation, compensate = math.radians(material.rotation) % (2.0 * math.pi), material.energy_compensation
    record["alpha_x"], record["alpha_y"] = ax, ay
    record["rotation"] = rotation if ax != ay else 0.0
    record["flags"] |= CONSTANTS["MATERIAL_FLAG_COMPENSATE"] if compensate else 0


def _record(scene: Scene, material: Material, texture_index: dict[str, int]) -> NDArray[Any]:
    record = _blank(material.type)
    color0, color1 = _colors(material)
    record["color0"], record["texture0"] = _color(scene, color0, texture_index)
    record["color1"], record["texture1"] = _color(scene, color1, texture_index)
    if isinstance(material, (Conductor, Plastic, Dielectric, ThinDielectric)):
        _set_roughness(record, material)
    if isinstance(material, (Plastic, Dielectric, ThinDielectric)):
        record["ior"] = material.ior
    if isinstance(material, Phong):
        record["exponent"] = material.exponent
    if isinstance(material, Conductor) and material.fresnel:
        record["flags"] |= CONSTANTS["MATERIAL_FLAG_FRESNEL"]
    return record


def _table(record: Any) -> NDArray[np.float64] | None:
    """The albedo table that a material needs, or None."""
    kind, compensate = int(record["type"]), bool(record["flags"] & CONSTANTS["MATERIAL_FLAG_COMPENSATE"])
    ax, ay, ior = (float(record[key]) for key in ("alpha_x", "alpha_y", "ior"))
    if kind == CONSTANTS["MATERIAL_PLASTIC"]:
        return albedo.coat_table(ax, ay, ior, compensate)
    if ax == 0.0 or not compensate:
        return None
    if kind == CONSTANTS["MATERIAL_CONDUCTOR"]:
        return albedo.conductor_table(ax, ay)
    if kind == CONSTANTS["MATERIAL_DIELECTRIC"]:
        return albedo.dielectric_tables(ax, ay, ior)
    if kind == CONSTANTS["MATERIAL_THIN_DIELECTRIC"]:
        return albedo.sheet_table(ax, ior)
    return None


def _table_key(record: Any) -> tuple[float, ...]:
    return tuple(float(record[key]) for key in ("type", "flags", "alpha_x", "alpha_y", "ior"))


def _tables(materials: NDArray[Any]) -> Iterator[tuple[int, tuple[float, ...], NDArray[np.float64]]]:
    """(material, key, table) of the materials that have one, in order; equal keys have equal tables."""
    for i, record in enumerate(materials):
        table = _table(record)
        if table is not None:
            yield i, _table_key(record), table


def compile_materials(scene: Scene, texture_index: dict[str, int]) -> tuple[NDArray[Any], dict[str, int]]:
    """(MATERIAL records, name -> index). Records 0 and 1 are DEFAULT_MATERIAL and BLACK_MATERIAL.

    Raises MaterialError where they need more than limits.MAX_ALBEDO_TABLES tables.
    """
    default = _blank("diffuse")
    default["color0"] = DEFAULT_GRAY
    records = [default, _blank("black")]
    index: dict[str, int] = {}
    for name, material in scene.materials.items():
        index[name] = len(records)
        records.append(_record(scene, material, texture_index))
    materials = np.array(records, MATERIAL)
    _place_tables(materials)
    return materials, index


def _place_tables(materials: NDArray[Any]) -> None:
    places: dict[tuple[float, ...], int] = {}
    size = 0
    for i, key, table in _tables(materials):
        if key not in places:
            places[key] = size
            size += len(table)
        if len(places) > limits.MAX_ALBEDO_TABLES:
            raise MaterialError(
                f"/materials: more than {limits.MAX_ALBEDO_TABLES} rough materials that differ in roughness, "
                "anisotropy or ior; accepted are as many: round them, or set energy_compensation to false"
            )
        materials["albedo"][i] = places[key]


def compile_albedo_table(materials: NDArray[Any]) -> NDArray[np.float32]:
    """The `albedo_table` buffer that compile_materials' records point into."""
    written: dict[tuple[float, ...], NDArray[np.float64]] = {
        key: table for _, key, table in _tables(materials)
    }
    if not written:
        return np.zeros(1, np.float32)
    return np.concatenate(list(written.values())).astype(np.float32)
