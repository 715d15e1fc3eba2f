"""A scene without one of its effects: what it would cost if its author had not asked for that.

Pure. What takes an effect's place is the plainest thing of the same kind: a pinhole, a closed shutter, Lambertian paint of the
same colour. The picture is another one; its time is what is compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

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
    ThinDielectric,
)
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Instance, Plane
from penumbra_scene.textures import ConstantTexture

GRAY: Final = (0.5, 0.5, 0.5)


def _replaced(model: Any, **values: Any) -> Any:
    return model.model_copy(update=values)


def _pinhole(scene: Scene) -> Scene:
    lens = _replaced(scene.camera.lens, aperture_radius=0.0)
    return _replaced(scene, camera=_replaced(scene.camera, lens=lens))  # type: ignore[no-any-return]


def _instant(scene: Scene) -> Scene:
    shutter = _replaced(scene.camera.shutter, close=scene.camera.shutter.open)
    return _replaced(scene, camera=_replaced(scene.camera, shutter=shutter))  # type: ignore[no-any-return]


def _unlit(shape: Any) -> Any:
    if isinstance(shape, (Plane, Instance)) or shape.emission is None:
        return shape
    return _replaced(shape, emission=_replaced(shape.emission, radiance=(0.0, 0.0, 0.0)))


def _no_area_lights(scene: Scene) -> Scene:
    prototypes = {name: tuple(map(_unlit, parts)) for name, parts in scene.prototypes.items()}
    return _replaced(scene, shapes=tuple(map(_unlit, scene.shapes)), prototypes=prototypes)  # type: ignore[no-any-return]


def _painted(color: Color) -> Diffuse:
    return Diffuse(type="diffuse", base_color=color)


def _matt(material: Material) -> Material:
    match material:
        case Phong() | Conductor() | Plastic():
            return _painted(material.base_color)
        case Mirror():
            return _painted(material.color)
        case Dielectric() | ThinDielectric():
            return _replaced(material, roughness=0.0)  # type: ignore[no-any-return]
        case _:
            return material


def _opaque(material: Material) -> Material:
    match material:
        case Dielectric() | ThinDielectric():
            return _painted(material.color)
        case DiffuseTransmission():
            return _painted(material.reflectance)
        case _:
            return material


def _materials(change: Callable[[Material], Material]) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        materials = {name: change(material) for name, material in scene.materials.items()}
        return _replaced(scene, materials=materials)  # type: ignore[no-any-return]

    return changed


def _plain(scene: Scene) -> Scene:
    textures = {name: ConstantTexture(type="constant", color=GRAY) for name in scene.textures}
    return _replaced(scene, textures=textures)  # type: ignore[no-any-return]


def _integrator(**values: Any) -> Callable[[Scene], Scene]:
    return lambda scene: _replaced(scene, integrator=_replaced(scene.integrator, **values))


REMOVALS: Final[dict[str, tuple[tuple[str, ...], Callable[[Scene], Scene]]]] = {
    "lens": (("lens",), _pinhole),
    "time": (("motion", "camera_motion", "deformation"), _instant),
    "area_lights": (("area_lights",), _no_area_lights),
    "delta_lights": (("delta_lights",), lambda scene: _replaced(scene, lights=())),
    "environment": (("environment",), lambda scene: _replaced(scene, environment=None)),
    "light_tree": (("light_tree",), _integrator(light_selection="power")),
    "gloss": (("gloss",), _materials(_matt)),
    "transmission": (("transmission",), _materials(_opaque)),
    "textures": (("textures",), _plain),
    "indirect": (("indirect",), _integrator(max_bounces=0)),
    "layers": (("layers",), lambda scene: _replaced(scene, film=_replaced(scene.film, layers=()))),
}
"""By name: the effects that go, and how."""
