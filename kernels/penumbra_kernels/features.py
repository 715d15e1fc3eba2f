"""Which effects a scene calls for: scene -> set of effects -> the 0/1 prologue of a program.

Pure: looks at the scene alone. Flags are coarse and few; counts, sizes, seeds and sample numbers never reach a program's
text. An effect is in only where something that the camera or a light can reach uses it (reach.py), and it says why.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from penumbra_scene.area import emits
from penumbra_scene.errors import pointer
from penumbra_scene.lights import DirectionalLight
from penumbra_scene.materials import (
    Conductor,
    Dielectric,
    Diffuse,
    DiffuseTransmission,
    Mirror,
    Phong,
    Plastic,
    ThinDielectric,
)
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Disc, Instance, Mesh, Plane, Quad, Sphere
from penumbra_scene.transforms import Transform

from penumbra_kernels.compile.materials import has_delta_lobe, widths
from penumbra_kernels.compile.placement import Shutter, deforms
from penumbra_kernels.compile.transforms import is_similarity, matrix_at, moves
from penumbra_kernels.layout import CONSTANTS
from penumbra_kernels.reach import (
    Path,
    is_black,
    lit_environment,
    placed_shapes,
    shines,
    texture_uses,
    used_materials,
)

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

TREE_LAMPS: Final = {(False, False): 2, (False, True): 3, (True, False): 5, (True, True): 1}
"""By whether there are an environment and directional lights: from how many lights with a place on the tree is the better
choice where the scene names none (docs/lights.md). A sky alone is sampled well without it."""


FEW_PRIMITIVES: Final = 256
"""Triangles, spheres, discs and instances up to which rays go through the trees sixteen together, so that programs leave out
rays in flight (docs/decisions/0015-sixteen-paths-in-lanes.md)."""


@dataclass(frozen=True)
class Feature:
    """One effect's verdict."""

    name: str
    present: bool
    reason: str
    pointer: str | None = None
    """JSON pointer to the place in the scene that calls for it."""


@dataclass(frozen=True)
class Features:
    """The verdict on every effect, in the order of EFFECTS, and the words that are not 0/1."""

    verdicts: tuple[Feature, ...]
    sampler: str
    area_sampling: bool
    adaptive: bool = False
    """Whether pixels take different numbers of samples; like the layers, it is no effect but asked for."""
    large_trees: bool = False
    """Whether there may be more than FEW_PRIMITIVES to meet. No effect: the bits are the same either way."""

    def __contains__(self, name: str) -> bool:
        return any(v.name == name and v.present for v in self.verdicts)

    @property
    def present(self) -> tuple[str, ...]:
        return tuple(v.name for v in self.verdicts if v.present)

    def flags(self) -> dict[str, int]:
        """Macros of the program that has just these effects."""
        return self._flags({v.name: v.present for v in self.verdicts}, self.large_trees)

    def plain_flags(self) -> dict[str, int]:
        """Macros of the program that has just these effects and takes one path at a time: slower, and built sooner."""
        return {**self.flags(), "PENUMBRA_TOGETHER": 0}

    def generic_flags(self) -> dict[str, int]:
        """Macros of the program that has every effect; layers stay as asked, since they change what is written."""
        present = {v.name: v.present if v.name == "layers" else True for v in self.verdicts}
        return self._flags(present, large_trees=True)

    def _flags(self, present: dict[str, bool], large_trees: bool) -> dict[str, int]:
        flags = {f"PENUMBRA_{name.upper()}": int(present[name]) for name in EFFECTS}
        flags["PENUMBRA_SAMPLER"] = CONSTANTS[f"SAMPLER_{self.sampler.upper()}"]
        flags["PENUMBRA_LIGHT_AREA_SAMPLING"] = int(self.area_sampling)
        flags["PENUMBRA_ADAPTIVE"] = int(self.adaptive)
        flags["PENUMBRA_LARGE_TREES"] = int(large_trees)
        flags["PENUMBRA_TOGETHER"] = 1
        return flags


@dataclass(frozen=True)
class Use:
    """Something in a scene that calls for an effect."""

    path: Path
    words: str
    """What is there: goes on where the path ends."""


@dataclass(frozen=True)
class Frame:
    """A scene at a time, seconds."""

    scene: Scene
    time: float

    @property
    def shutter(self) -> Shutter:
        return Shutter(self.time, self.scene.camera.shutter.open, self.scene.camera.shutter.close)

    def moves(self, transform: Transform) -> bool:
        """Whether something moves while the shutter is open."""
        return moves(transform, self.time, self.shutter.open, self.shutter.close)


def analyse(scene: Scene, time: float = 0.0) -> Features:
    """Decide on every effect for the frame at `time` seconds."""
    frame = Frame(scene, time)
    verdicts = tuple(_verdict(scene, name, next(iter(_FINDERS[name](frame)), None)) for name in EFFECTS)
    return Features(
        verdicts,
        scene.sampler.type,
        scene.integrator.light_sampling == "area",
        scene.adaptive is not None,
        _has_large_trees(scene),
    )


def _has_large_trees(scene: Scene) -> bool:
    """Meshes from assets count as large: how many triangles they have is not known here."""
    count = 0
    for _, shape in placed_shapes(scene):
        if isinstance(shape, Mesh):
            if shape.indices is None:
                return True
            count += len(shape.indices)
        else:
            count += 2 if isinstance(shape, Quad) else 1
    return count > FEW_PRIMITIVES


def _verdict(scene: Scene, effect: str, use: Use | None) -> Feature:
    if use is None:
        return Feature(effect, False, "nothing uses it")
    place = "/".join(str(key) for key in use.path)
    named = _name_at(scene, use.path)
    where = f"{place} ({named})" if named else place
    return Feature(effect, True, f"{where} {use.words}", pointer(use.path))


def _name_at(scene: Scene, path: Path) -> str | None:
    """What a shape or light at the top of the scene calls itself."""
    if path[0] not in ("shapes", "lights") or len(path) != 2:
        return None
    things: Any = getattr(scene, str(path[0]))
    name: str | None = things[path[1]].name
    return name


def _lens(frame: Frame) -> Iterable[Use]:
    radius = frame.scene.camera.lens.aperture_radius
    if radius > 0:
        yield Use(("camera", "lens", "aperture_radius"), f"is {radius:g} m")


def _camera_motion(frame: Frame) -> Iterable[Use]:
    if frame.moves(frame.scene.camera.transform):
        yield Use(("camera", "transform"), "moves while the shutter is open")


def _shining(scene: Scene) -> Iterator[tuple[Path, Any]]:
    for i, light in enumerate(scene.lights):
        if shines(light):
            yield ("lights", i), light


def _motion(frame: Frame) -> Iterable[Use]:
    for path, thing in (*placed_shapes(frame.scene), *_shining(frame.scene)):
        if frame.moves(thing.transform):
            yield Use(path, "moves while the shutter is open")


def _deformation(frame: Frame) -> Iterable[Use]:
    for path, shape in placed_shapes(frame.scene):
        if isinstance(shape, Mesh) and deforms(shape, frame.shutter):
            yield Use(path, "deforms while the shutter is open")


def _instancing(frame: Frame) -> Iterable[Use]:
    for path, shape in placed_shapes(frame.scene):
        if isinstance(shape, Instance):
            yield Use(path, "is an instance")
        elif not isinstance(shape, Plane) and frame.moves(shape.transform):
            yield Use(path, "moves")
        elif isinstance(shape, Sphere) and not is_similarity(matrix_at(shape.transform, frame.shutter.first)):
            yield Use(path, "is a stretched sphere")


def _round(frame: Frame) -> Iterable[Use]:
    for path, shape in placed_shapes(frame.scene):
        if isinstance(shape, (Sphere, Disc, Plane)):
            yield Use(path, f"is a {shape.type}")


def _area_lights(frame: Frame) -> Iterable[Use]:
    for path, shape in placed_shapes(frame.scene):
        if emits(shape):
            yield Use(path, "emits")


def _delta_lights(frame: Frame) -> Iterable[Use]:
    for path, light in _shining(frame.scene):
        yield Use(path, f"is a {light.type} light")


def _lights_to_meet(scene: Scene) -> bool:
    """Whether some light has an extent, so that a ray can meet it."""
    return lit_environment(scene) is not None or any(emits(shape) for _, shape in placed_shapes(scene))


def _light_count(scene: Scene) -> int:
    """Lights that shine: every placed copy of an emitting prototype is one."""
    count = len(tuple(_shining(scene))) + (lit_environment(scene) is not None)
    for shape in scene.shapes:
        parts = scene.prototypes.get(shape.prototype, ()) if isinstance(shape, Instance) else (shape,)
        count += sum(emits(part) for part in parts)
    return count


def _many_lights(frame: Frame) -> Iterable[Use]:
    count = _light_count(frame.scene)
    if count > 1:
        yield Use(("integrator", "light_selection"), f"has {count} lights to choose from")


def light_selection(scene: Scene) -> str:
    """How lights are chosen: what the scene says, or what serves its number of lights."""
    said = scene.integrator.light_selection
    if said != "auto":
        return said
    sky = lit_environment(scene) is not None
    suns = sum(isinstance(light, DirectionalLight) for _, light in _shining(scene))
    lamps = _light_count(scene) - sky - suns
    return "tree" if lamps >= TREE_LAMPS[sky, suns > 0] else "power"


def _light_tree(frame: Frame) -> Iterable[Use]:
    if _light_count(frame.scene) > 1 and light_selection(frame.scene) == "tree":
        yield Use(("integrator", "light_selection"), "is the light tree")


def _environment(frame: Frame) -> Iterable[Use]:
    environment = lit_environment(frame.scene)
    if environment is not None:
        yield Use(("environment",), f"is {environment.type}")


def _environment_image(frame: Frame) -> Iterable[Use]:
    environment = lit_environment(frame.scene)
    if environment is not None and environment.type == "image":
        yield Use(("environment",), "is an image")


def _gloss(frame: Frame) -> Iterable[Use]:
    for name, material in used_materials(frame.scene).items():
        if isinstance(material, (Phong, Mirror, Conductor, Plastic)):
            yield Use(("materials", name), f"is {material.type}")
        elif isinstance(material, (Dielectric, ThinDielectric)) and widths(material)[0] > 0:
            yield Use(("materials", name), "is rough")


def _transmission(frame: Frame) -> Iterable[Use]:
    for name, material in used_materials(frame.scene).items():
        if isinstance(material, (Dielectric, ThinDielectric, DiffuseTransmission)):
            yield Use(("materials", name), "transmits")


def _textures(frame: Frame) -> Iterable[Use]:
    for path, texture in texture_uses(frame.scene):
        yield Use(path, f"is the texture {texture}")


def _indirect(frame: Frame) -> Iterable[Use]:
    if _light_count(frame.scene) == 0:
        return
    bounces = frame.scene.integrator.max_bounces
    meets = frame.scene.integrator.mis and _lights_to_meet(frame.scene)
    if bounces > 0 and _reflects(frame.scene):
        yield Use(("integrator", "max_bounces"), f"is {bounces}")
    for name, material in used_materials(frame.scene).items():
        if has_delta_lobe(material):
            yield Use(("materials", name), "shows lights in its mirror directions even without bounces")
        elif meets and not isinstance(material, (Diffuse, DiffuseTransmission)):
            yield Use(("materials", name), "has lobes that look for lights even without bounces")


def _reflects(scene: Scene) -> bool:
    """Whether some surface sends light on. Lamps without a material are black, other shapes without one gray."""
    if any(
        not isinstance(m, Diffuse) or not is_black(scene, m.base_color)
        for m in used_materials(scene).values()
    ):
        return True
    return any(
        not isinstance(shape, Instance)
        and shape.material is None
        and (isinstance(shape, Plane) or shape.emission is None)
        for _, shape in placed_shapes(scene)
    )


def _layers(frame: Frame) -> Iterable[Use]:
    layers = frame.scene.film.layers
    if layers:
        yield Use(("film", "layers"), f"asks for {', '.join(layers)}")


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
