"""What of a scene light or the camera can reach: the rest is neither analysed nor compiled.

Pure. Materials that no placed shape names, textures that no such material names, prototypes without an instance, lights
without power, materials that say in many words what a simpler one says in few.
"""

from __future__ import annotations

from collections.abc import Iterator

from penumbra_scene.lights import ConstantEnvironment, DirectionalLight, Environment, Light
from penumbra_scene.materials import Color, Diffuse, DiffuseTransmission, Material, Phong, TextureRef
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Disc, Instance, Mesh, Quad, Shape, Sphere
from penumbra_scene.textures import ConstantTexture

Path = tuple[str | int, ...]
"""Of a JSON pointer."""


def placed_shapes(scene: Scene) -> Iterator[tuple[Path, Shape | Sphere | Quad | Disc | Mesh]]:
    """Every shape that is really there, with its place in the scene: prototypes only where something instances them."""
    used = set()
    for i, shape in enumerate(scene.shapes):
        yield ("shapes", i), shape
        if isinstance(shape, Instance):
            used.add(shape.prototype)
    for name in sorted(used & scene.prototypes.keys()):
        for i, part in enumerate(scene.prototypes[name]):
            yield ("prototypes", name, i), part


def used_materials(scene: Scene) -> dict[str, Material]:
    """The materials that placed shapes name, in the scene's order, each as simple as it can be said."""
    names = {s.material for _, s in placed_shapes(scene) if not isinstance(s, Instance)}
    return {name: simplified(scene, m) for name, m in scene.materials.items() if name in names}


def simplified(scene: Scene, material: Material) -> Material:
    """A Phong cone without a colour and a leaf that lets nothing through are Lambertian."""
    if isinstance(material, Phong) and is_black(scene, material.specular_color):
        return Diffuse(type="diffuse", base_color=material.base_color)
    if isinstance(material, DiffuseTransmission) and is_black(scene, material.transmittance):
        return Diffuse(type="diffuse", base_color=material.reflectance)
    return material


def constant_color(scene: Scene, color: Color) -> tuple[float, float, float] | None:
    """The colour where it is the same everywhere; None where a texture varies it."""
    if not isinstance(color, TextureRef):
        return color
    texture = scene.textures[color.texture]
    return texture.color if isinstance(texture, ConstantTexture) else None


def is_black(scene: Scene, color: Color) -> bool:
    """Whether a colour is black everywhere."""
    constant = constant_color(scene, color)
    return constant is not None and not any(constant)


def texture_uses(scene: Scene) -> Iterator[tuple[Path, str]]:
    """(place, texture) of every colour of a used material that really varies."""
    for name, material in used_materials(scene).items():
        for key in type(material).model_fields:
            value = getattr(material, key)
            if isinstance(value, TextureRef) and constant_color(scene, value) is None:
                yield ("materials", name, key), value.texture


def shines(light: Light) -> bool:
    """Whether a light without a body gives light."""
    return any(light.irradiance if isinstance(light, DirectionalLight) else light.intensity)


def lit_environment(scene: Scene) -> Environment | None:
    """The environment where it gives light; an image counts as doing so unless its scale is 0."""
    environment = scene.environment
    if environment is None:
        return None
    lit = any(environment.radiance) if isinstance(environment, ConstantEnvironment) else environment.scale > 0
    return environment if lit else None


def stripped(scene: Scene) -> Scene:
    """The scene without what nothing can reach; the same picture. Shapes and their numbers stay as they are."""
    materials = used_materials(scene)
    textures = {name for _, name in texture_uses(scene)}
    return scene.model_copy(
        update={
            # Constant textures are folded into colours, which needs them there.
            "textures": {
                name: t
                for name, t in scene.textures.items()
                if name in textures or isinstance(t, ConstantTexture)
            },
            "materials": materials,
            "lights": tuple(light for light in scene.lights if shines(light)),
            "environment": lit_environment(scene),
        }
    )
