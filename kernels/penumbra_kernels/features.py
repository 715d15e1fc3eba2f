"""Which effects a scene calls for: scene -> set of effects -> the 0/1 prologue of a program.

Pure: looks at the scene alone. Flags are coarse and few; counts, sizes, seeds and sample numbers never reach a program's
text. An effect is in only where something that the camera or a light can reach uses it, and it says why.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from penumbra_scene.camera import Camera
from penumbra_scene.materials import Material, TextureRef
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Disc, Instance, Mesh, Plane, Quad, Shape, Sphere
from penumbra_scene.transforms import Transform

from penumbra_kernels.compile.transforms import is_similarity, matrix_at, moves
from penumbra_kernels.layout import CONSTANTS

EFFECTS: Final = (
    "lens",
    "camera_motion",
    "motion",
    "deformation",
    "instancing",
    "round",
    "area_lights",
    "delta_lights",
    "many_lights",
    "light_tree",
    "environment",
    "environment_image",
    "gloss",
    "transmission",
    "textures",
    "indirect",
    "layers",
)
"""Every effect that a program can do without, by the name of its PENUMBRA_* flag in lower case."""

GLOSSY: Final = frozenset({"phong", "mirror", "conductor", "plastic", "dielectric", "thin_dielectric"})
TREE_LIGHTS: Final = 4
"""From how many lights on the tree is the better choice where the scene names none (docs/lights.md)."""
TRANSMITTING: Final = frozenset({"dielectric", "thin_dielectric", "diffuse_transmission"})


@dataclass(frozen=True)
class Feature:
    """One effect's verdict."""

    name: str
    present: bool
    reason: str


@dataclass(frozen=True)
class Features:
    """The verdict on every effect, in the order of EFFECTS, and the words that are not 0/1."""

    verdicts: tuple[Feature, ...]
    sampler: str
    area_sampling: bool
    adaptive: bool = False
    """Whether pixels take different numbers of samples; like the layers, it is no effect but asked for."""

    def __contains__(self, name: str) -> bool:
        return any(v.name == name and v.present for v in self.verdicts)

    @property
    def present(self) -> tuple[str, ...]:
        return tuple(v.name for v in self.verdicts if v.present)

    def flags(self) -> dict[str, int]:
        """Macros of the program that has just these effects."""
        return self._flags({v.name: v.present for v in self.verdicts})

    def generic_flags(self) -> dict[str, int]:
        """Macros of the program that has every effect; layers stay as asked, since they change what is written."""
        return self._flags({v.name: v.present if v.name == "layers" else True for v in self.verdicts})

    def _flags(self, present: dict[str, bool]) -> dict[str, int]:
        flags = {f"PENUMBRA_{name.upper()}": int(present[name]) for name in EFFECTS}
        flags["PENUMBRA_SAMPLER"] = CONSTANTS[f"SAMPLER_{self.sampler.upper()}"]
        flags["PENUMBRA_LIGHT_AREA_SAMPLING"] = int(self.area_sampling)
        flags["PENUMBRA_ADAPTIVE"] = int(self.adaptive)
        return flags


def analyse(scene: Scene, time: float = 0.0) -> Features:
    """Decide on every effect for the frame at `time` seconds."""
    reasons = {name: next(_reasons(name, scene, time), "") for name in EFFECTS}
    verdicts = tuple(
        Feature(name, bool(reason), reason or "nothing uses it") for name, reason in reasons.items()
    )
    return Features(
        verdicts, scene.sampler.type, scene.integrator.light_sampling == "area", scene.adaptive is not None
    )


def _reasons(effect: str, scene: Scene, time: float) -> Iterator[str]:
    return iter(_FINDERS[effect](scene, time))


def _moves(transform: Transform, camera: Camera, time: float) -> bool:
    shutter = camera.shutter
    return moves(transform, time, shutter.open, shutter.close)


def _where(kind: str, index: int, name: str | None) -> str:
    return f"{kind}/{index}" + (f" ({name})" if name else "")


def _shapes(scene: Scene) -> Iterator[tuple[str, Shape | Sphere | Quad | Disc | Mesh]]:
    """Every shape that is really placed in the scene, with where it stands."""
    used = set()
    for i, shape in enumerate(scene.shapes):
        yield _where("shapes", i, shape.name), shape
        if isinstance(shape, Instance):
            used.add(shape.prototype)
    for name in sorted(used & scene.prototypes.keys()):
        for i, shape in enumerate(scene.prototypes[name]):
            yield f"prototypes/{name}/{i}", shape


def used_materials(scene: Scene) -> Iterator[tuple[str, Material]]:
    """Every material that some placed shape has, with where it stands."""
    names = {s.material for _, s in _shapes(scene) if not isinstance(s, Instance) and s.material is not None}
    for name in sorted(names & scene.materials.keys()):
        yield f"materials/{name}", scene.materials[name]


def _lens(scene: Scene, time: float) -> Iterable[str]:
    if scene.camera.lens.aperture_radius > 0:
        yield f"camera/lens/aperture_radius is {scene.camera.lens.aperture_radius:g} m"


def _camera_motion(scene: Scene, time: float) -> Iterable[str]:
    if _moves(scene.camera.transform, scene.camera, time):
        yield "camera/transform moves while the shutter is open"


def _motion(scene: Scene, time: float) -> Iterable[str]:
    for where, shape in _shapes(scene):
        if _moves(shape.transform, scene.camera, time):
            yield f"{where} moves while the shutter is open"
    for i, light in enumerate(scene.lights):
        if _moves(light.transform, scene.camera, time):
            yield f"{_where('lights', i, light.name)} moves while the shutter is open"


def _deformation(scene: Scene, time: float) -> Iterable[str]:
    for where, shape in _shapes(scene):
        if (
            isinstance(shape, Mesh)
            and shape.deformation is not None
            and scene.camera.shutter.close > scene.camera.shutter.open
        ):
            yield f"{where} deforms while the shutter is open"


def _instancing(scene: Scene, time: float) -> Iterable[str]:
    for where, shape in _shapes(scene):
        if isinstance(shape, Instance):
            yield f"{where} is an instance"
        elif not isinstance(shape, Plane) and _moves(shape.transform, scene.camera, time):
            yield f"{where} moves"
        elif isinstance(shape, Sphere) and not is_similarity(matrix_at(shape.transform, time)):
            yield f"{where} is a stretched sphere"


def _round(scene: Scene, time: float) -> Iterable[str]:
    for where, shape in _shapes(scene):
        if isinstance(shape, (Sphere, Disc, Plane)):
            yield f"{where} is a {shape.type}"


def emitting_shapes(scene: Scene) -> Iterator[str]:
    """Where the shapes stand that emit."""
    for where, shape in _shapes(scene):
        if isinstance(shape, (Sphere, Quad, Disc, Mesh)) and shape.emission is not None:
            yield where


def _area_lights(scene: Scene, time: float) -> Iterable[str]:
    for where in emitting_shapes(scene):
        yield f"{where} emits"


def _delta_lights(scene: Scene, time: float) -> Iterable[str]:
    for i, light in enumerate(scene.lights):
        yield f"{_where('lights', i, light.name)} is a {light.type} light"


def _emitter_count(scene: Scene) -> int:
    """Area lights: every placed copy of an emitting prototype is one."""
    count = 0
    for shape in scene.shapes:
        parts = scene.prototypes.get(shape.prototype, ()) if isinstance(shape, Instance) else (shape,)
        count += sum(not isinstance(part, (Plane, Instance)) and part.emission is not None for part in parts)
    return count


def _light_count(scene: Scene) -> int:
    return _emitter_count(scene) + len(scene.lights) + (scene.environment is not None)


def _many_lights(scene: Scene, time: float) -> Iterable[str]:
    count = _light_count(scene)
    if count > 1:
        yield f"there are {count} lights to choose from"


def light_selection(scene: Scene) -> str:
    """How lights are chosen: what the scene says, or what serves its number of lights."""
    said = scene.integrator.light_selection
    if said != "auto":
        return said
    return "tree" if _light_count(scene) >= TREE_LIGHTS else "power"


def _light_tree(scene: Scene, time: float) -> Iterable[str]:
    count = _light_count(scene)
    if count > 1 and light_selection(scene) == "tree":
        yield f"{count} lights are chosen by the light tree"


def _environment(scene: Scene, time: float) -> Iterable[str]:
    if scene.environment is not None:
        yield f"environment is {scene.environment.type}"


def _environment_image(scene: Scene, time: float) -> Iterable[str]:
    if scene.environment is not None and scene.environment.type == "image":
        yield "environment is an image"


def _gloss(scene: Scene, time: float) -> Iterable[str]:
    for where, material in used_materials(scene):
        if material.type in GLOSSY:
            yield f"{where} is {material.type}"


def _transmission(scene: Scene, time: float) -> Iterable[str]:
    for where, material in used_materials(scene):
        if material.type in TRANSMITTING:
            yield f"{where} transmits"


def _textures(scene: Scene, time: float) -> Iterable[str]:
    for where, material in used_materials(scene):
        for key in type(material).model_fields:
            value = getattr(material, key)
            if isinstance(value, TextureRef):
                yield f"{where}/{key} is the texture {value.texture}"


def _indirect(scene: Scene, time: float) -> Iterable[str]:
    if scene.integrator.max_bounces > 0:
        yield f"integrator/max_bounces is {scene.integrator.max_bounces}"
    for reason in _gloss(scene, time):
        yield f"{reason}: mirrors show lights even without bounces"


def _layers(scene: Scene, time: float) -> Iterable[str]:
    if scene.film.layers:
        yield f"film/layers asks for {', '.join(scene.film.layers)}"


_FINDERS: Final = {
    "lens": _lens,
    "camera_motion": _camera_motion,
    "motion": _motion,
    "deformation": _deformation,
    "instancing": _instancing,
    "round": _round,
    "area_lights": _area_lights,
    "delta_lights": _delta_lights,
    "many_lights": _many_lights,
    "light_tree": _light_tree,
    "environment": _environment,
    "environment_image": _environment_image,
    "gloss": _gloss,
    "transmission": _transmission,
    "textures": _textures,
    "indirect": _indirect,
    "layers": _layers,
}
