"""What no single model can see: names that must exist, settings that must agree, totals with limits."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final

from penumbra_scene import limits
from penumbra_scene.adaptive import Adaptive
from penumbra_scene.area import LEAST_AREA, MOST_TRIANGLES_LOOKED_AT, emits, flat_triangles, has_area
from penumbra_scene.assets import AssetRef
from penumbra_scene.errors import pointer, shorten
from penumbra_scene.film import BoxFilter, MitchellFilter
from penumbra_scene.lights import ImageEnvironment
from penumbra_scene.materials import Conductor, Dielectric, Phong, Plastic, TextureRef, ThinDielectric
from penumbra_scene.placement import Affine, placements
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Instance, Mesh, Plane, Shape, Sphere
from penumbra_scene.textures import ImageTexture
from penumbra_scene.transforms import Keyframes, Step

_SEEN: Final = ("camera", "textures", "materials", "prototypes", "shapes", "lights", "environment")
"""Sections of a scene that are looked at, whoever samples them."""
_FIXED_PLACES: Final = ("regular", "stratified")
"""Samplers that take the same few places in every pixel, however many samples there are."""
_PIXEL_BOX: Final = 0.5
"""Radius of the box filter that is exactly one pixel."""
_UNIFORM: Final = 1e-5
"""Relative difference of scale factors that still counts as one factor: far above what rotations written with
six digits leave, far below what would show."""


@dataclass(frozen=True)
class SceneError:
    """Something wrong with a scene, or, with `warning`, something that is probably not meant."""

    pointer: str
    message: str
    given: str = ""
    accepted: str = ""
    warning: bool = False


def check_scene(scene: Scene, *, allow_files: bool = False) -> list[SceneError]:
    """All cross-reference errors and warnings of a scene; `allow_files` where assets may be named by file."""
    found: list[SceneError] = []
    for check in (_names, _sampling, _emitters, _totals, _sizes, _energy, _flat, _light):
        found += check(scene)
    if not allow_files:
        found += _files(scene)
    return found


def _each_shape(scene: Scene) -> Iterator[tuple[tuple[str | int, ...], Shape]]:
    for i, shape in enumerate(scene.shapes):
        yield ("shapes", i), shape
    for name, group in scene.prototypes.items():
        for i, part in enumerate(group):
            yield ("prototypes", name, i), part


def _texture_refs(scene: Scene) -> Iterator[tuple[tuple[str | int, ...], str]]:
    for name, material in scene.materials.items():
        for key in type(material).model_fields:
            value = getattr(material, key)
            if isinstance(value, TextureRef):
                yield ("materials", name, key, "texture"), value.texture


def asset_refs(scene: Scene) -> Iterator[tuple[str, AssetRef]]:
    """Every asset that a scene names, with the JSON pointer to it."""
    for name, texture in scene.textures.items():
        if isinstance(texture, ImageTexture):
            yield pointer(("textures", name, "image")), texture.image
    for path, shape in _each_shape(scene):
        if isinstance(shape, Mesh) and shape.source is not None:
            yield pointer((*path, "source")), shape.source
    if isinstance(scene.environment, ImageEnvironment):
        yield "/environment/image", scene.environment.image


def _names(scene: Scene) -> Iterator[SceneError]:
    for path, texture in _texture_refs(scene):
        yield from _known(path, texture, scene.textures, "texture")
    for path, shape in _each_shape(scene):
        if isinstance(shape, Instance):
            yield from _known((*path, "prototype"), shape.prototype, scene.prototypes, "prototype")
        elif shape.material is not None:
            yield from _known((*path, "material"), shape.material, scene.materials, "material")


def _known(
    path: tuple[str | int, ...], name: str, table: Mapping[str, Any], what: str
) -> Iterator[SceneError]:
    if name in table:
        return
    close = get_close_matches(name, list(table)[:1000], 1)
    message = f"there is no {what} of this name" + (f"; did you mean {shorten(close[0])}?" if close else "")
    yield SceneError(pointer(path), message, shorten(name), _a_few(table, f"{what}s"))


def _a_few(table: Mapping[str, Any], what: str) -> str:
    if not table:
        return f"a name under the scene's `{what}`, which is empty"
    names = [shorten(name) for name in list(table)[:12]]
    return " | ".join(names) + (f" | ... ({len(table)} in all)" if len(table) > len(names) else "")


def _sampling(scene: Scene) -> Iterator[SceneError]:
    sampler, stop, film = scene.sampler, scene.stop, scene.film
    if sampler.type == "random" and film.filter != BoxFilter(type="box", radius=_PIXEL_BOX):
        yield SceneError(
            "/film/filter",
            "the sampler `random` gives each pixel the samples that fall into it, which is the box filter",
            shorten(film.filter.model_dump(mode="json")),
            '{"type": "box", "radius": 0.5}, or another sampler',
        )
    if sampler.type in _FIXED_PLACES and isinstance(film.filter, MitchellFilter) and film.filter.c > 0:
        yield SceneError(
            "/film/filter",
            f"the sampler `{sampler.type}` has fixed places in the pixel, and more or fewer of them than is due lie in the "
            "filter's negative lobes: the picture would be too bright or too dark",
            shorten(film.filter.model_dump(mode="json")),
            '"c": 0, another filter, or another sampler',
        )
    if stop.relative_error is not None:
        yield from _target(scene)
    if scene.adaptive is not None:
        yield from _adaptive(scene, scene.adaptive)
    if sampler.replicates is None:
        return
    if sampler.type == "regular" and sampler.replicates > 1:
        message = "the sampler `regular` takes the same samples every time: its replicates cannot differ"
        yield SceneError("/sampler/replicates", message, str(sampler.replicates), "1, or null")
    if stop.samples is not None and sampler.replicates > stop.samples:
        message = "there cannot be more replicates than samples"
        yield SceneError("/sampler/replicates", message, str(sampler.replicates), f"at most {stop.samples}")


def _target(scene: Scene) -> Iterator[SceneError]:
    """An error target needs a sampler from which an error can be estimated."""
    given = str(scene.stop.relative_error)
    at = "/stop/relative_error"
    if scene.sampler.type == "regular":
        accepted = "null, or a sampler other than `regular`"
        yield SceneError(at, "a deterministic sampler has no variance to aim at", given, accepted)
    elif scene.sampler.replicates == 1:
        yield SceneError(
            at, "one replicate has no variance to aim at", given, "null, or 2 or more replicates"
        )
    elif scene.stop.samples == 1:
        yield SceneError(at, "one sample has no variance to aim at", given, "null, or 2 or more samples")


def _adaptive(scene: Scene, adaptive: Adaptive) -> Iterator[SceneError]:
    """Adaptive sampling needs pixels that can get more or fewer samples, and `error` a variance to go by."""
    sampler, at = scene.sampler, "/adaptive/strategy"
    if sampler.type == "random":
        message = "the sampler `random` throws its samples over the whole plane: no pixel can be given more"
        yield SceneError(at, message, shorten(adaptive.strategy), "null, or another sampler")
    elif adaptive.strategy == "error" and sampler.type == "regular":
        message = "a deterministic sampler has no variance to go by"
        accepted = '"contrast", or a sampler other than `regular`'
        yield SceneError(at, message, shorten(adaptive.strategy), accepted)
    elif adaptive.strategy == "error" and (sampler.replicates == 1 or scene.stop.samples == 1):
        message = "one replicate has no variance to go by"
        yield SceneError(at, message, shorten(adaptive.strategy), '"contrast", or 2 or more replicates')
    if adaptive.biased and scene.stop.samples is not None and adaptive.pilot_samples is not None:
        yield from _kept(adaptive.pilot_samples, scene.stop.samples)


def _kept(pilot: int, samples: int) -> Iterator[SceneError]:
    if pilot > samples:
        message = "the picture begins with the samples that decide: there cannot be more of them than samples"
        yield SceneError("/adaptive/pilot_samples", message, str(pilot), f"at most {samples}")


def _emitters(scene: Scene) -> Iterator[SceneError]:
    for name, group in scene.prototypes.items():
        for i, part in enumerate(group):
            if part.emission is not None:
                at = pointer(("prototypes", name, i, "emission"))
                given = shorten(part.emission.model_dump(mode="json"))
                yield SceneError(at, "prototypes cannot emit", given, "null; put the light under `shapes`")
    for i, shape in enumerate(scene.shapes):
        if isinstance(shape, Sphere) and shape.emission is not None and not _round(shape):
            message = "a sphere that emits must stay a sphere: its scale must be the same along every axis"
            accepted = "a uniform scale, or an emitting mesh"
            at = pointer(("shapes", i, "transform"))
            yield SceneError(at, message, _as_given(shape.transform), accepted)


def _as_given(transform: tuple[Step, ...] | Keyframes) -> str:
    if isinstance(transform, Keyframes):
        return f"{len(transform.keyframes)} keyframes"
    return shorten([step.model_dump(mode="json") for step in transform])


def _round(sphere: Sphere) -> bool:
    return all(_is_similarity(matrix) for matrix in placements(sphere.transform))


def _is_similarity(m: Affine) -> bool:
    """Whether the linear part's columns are orthogonal and equally long."""
    columns = [[m[i][j] for i in range(3)] for j in range(3)]
    size = max(sum(x * x for x in c) for c in columns)
    for j in range(3):
        for k in range(j, 3):
            dot = sum(a * b for a, b in zip(columns[j], columns[k], strict=True))
            if abs(dot - (size if j == k else 0.0)) > 2 * _UNIFORM * size:
                return False
    return True


def inline_triangles(scene: Scene) -> int:
    """Triangles that the scene itself brings; those of assets come on top."""
    return sum(len(s.indices or ()) for _, s in _each_shape(scene) if isinstance(s, Mesh))


def too_many_triangles(count: int) -> SceneError | None:
    """The error of a scene with so many triangles, if that is one."""
    if count <= limits.MAX_TRIANGLES:
        return None
    accepted = f"at most {limits.MAX_TRIANGLES} in all; place copies as instances"
    return SceneError("/shapes", "there are too many triangles", str(count), accepted)


def _totals(scene: Scene) -> Iterator[SceneError]:
    crowded = too_many_triangles(inline_triangles(scene))
    if crowded is not None:
        yield crowded
    shapes = sum(1 for _ in _each_shape(scene))
    if shapes > limits.MAX_SHAPES:
        yield SceneError("/shapes", "there are too many shapes", str(shapes), f"at most {limits.MAX_SHAPES}")
    rough = len(_rough_kinds(scene))
    if rough > limits.MAX_ALBEDO_TABLES:
        accepted = f"at most {limits.MAX_ALBEDO_TABLES}: round them, or set energy_compensation to false"
        message = "there are too many materials that differ in roughness, anisotropy or ior"
        yield SceneError("/materials", message, str(rough), accepted)


def _rough_kinds(scene: Scene) -> set[tuple[str | float, ...]]:
    """What the materials that are prepared by a table of their own differ in."""
    kinds: set[tuple[str | float, ...]] = set()
    for material in scene.materials.values():
        if isinstance(material, Plastic) or (
            isinstance(material, (Conductor, Dielectric)) and material.energy_compensation
        ):
            ior = 0.0 if isinstance(material, Conductor) else material.ior
            kinds.add((material.type, material.roughness, material.anisotropy, ior))
        elif isinstance(material, ThinDielectric):
            kinds.add((material.type, material.roughness, material.ior))
    return kinds


def _sizes(scene: Scene) -> Iterator[SceneError]:
    """Transforms are checked as a whole: steps that are harmless alone can pass all bounds together."""
    placed: Iterable[tuple[tuple[str | int, ...], Any]] = [
        (("camera",), scene.camera),
        *_each_shape(scene),
        *((("lights", i), light) for i, light in enumerate(scene.lights)),
    ]
    for path, thing in placed:
        if thing.transform and not all(_bounded(m) for m in placements(thing.transform)):
            message = f"the steps together give numbers above {limits.MAX_MAGNITUDE:g}, or squash space flat"
            at = pointer((*path, "transform"))
            yield SceneError(
                at, message, _as_given(thing.transform), "smaller or larger factors and distances"
            )


def _bounded(m: Affine) -> bool:
    """Also refuses NaN, since every comparison with it is false."""
    if not all(abs(x) <= limits.MAX_MAGNITUDE for row in m for x in row):
        return False
    return all(max(abs(m[i][j]) for i in range(3)) >= limits.MIN_DIRECTION for j in range(3))


def _energy(scene: Scene) -> Iterator[SceneError]:
    for name, material in scene.materials.items():
        if not isinstance(material, Phong) or isinstance(material.base_color, TextureRef):
            continue
        if isinstance(material.specular_color, TextureRef):
            continue
        if any(a + b > 1 + 1e-12 for a, b in zip(material.base_color, material.specular_color, strict=True)):
            message = "base_color + specular_color exceeds 1: this surface gives back more light than it gets"
            yield SceneError(pointer(("materials", name)), message, warning=True)


def _flat(scene: Scene) -> Iterator[SceneError]:
    """Points and lines: no ray meets them, and they give no light."""
    for path, shape in _each_shape(scene):
        if isinstance(shape, (Plane, Instance)):
            continue
        effect = "never seen" + ("" if shape.emission is None else " and gives no light")
        flat = _flat_among(shape)
        if isinstance(shape, Mesh) and flat:
            share = "all" if flat == len(shape.indices or ()) else f"{flat} of {len(shape.indices or ())}"
            message = f"{share} triangles have no area: they are {effect.replace('gives', 'give')}"
            yield SceneError(pointer((*path, "indices")), message, warning=True)
        elif path[0] == "shapes" and not has_area(shape):  # a prototype's size is its instances'
            message = f"its area is below {LEAST_AREA:.2g} m^2, which is nothing in float32: it is {effect}"
            yield SceneError(pointer(path), message, warning=True)


def _flat_among(shape: Shape) -> int:
    if not isinstance(shape, Mesh) or len(shape.indices or ()) > MOST_TRIANGLES_LOOKED_AT:
        return 0
    return flat_triangles(shape)


def _light(scene: Scene) -> Iterator[SceneError]:
    if not any(map(emits, scene.shapes)) and not scene.lights and scene.environment is None:
        message = "the scene has no light: no lights, no environment, no shape of some area with an emission"
        yield SceneError("", message, warning=True)
    if not scene.shapes and scene.environment is None:
        yield SceneError("/shapes", "the scene is empty: the picture will be black", warning=True)


def _files(scene: Scene) -> Iterator[SceneError]:
    for at, ref in asset_refs(scene):
        if ref.file is not None:
            message = "files can be named on the command line only; upload it to /v1/assets and name its hash"
            yield SceneError(at + "/file", message, shorten(ref.file), '{"asset": "sha256:..."}')


_NEGATIVE_ZERO: Final = re.compile(rb"(?<=[\[,:])-0\.0(?=[,\]}])")


def scene_hash(scene: Scene) -> str:
    """'sha256:...' of the scene in canonical JSON.

    Every default is written out, keys stand in the contract's order, the scene's own names are sorted, and
    -0 is 0: two documents that mean the same have the same hash.
    """
    return "sha256:" + hashlib.sha256(_canonical(scene)).hexdigest()


def picture_hash(scene: Scene, time: float = 0.0) -> str:
    """'sha256:...' of what decides the picture that a render converges to, `time` seconds into the scene.

    Left out are the name, the sampler with its seed, the stop rule, how the estimator goes about it, and how
    the picture is stored: renders that differ in these alone estimate the same pixels.
    """
    document = json.loads(_canonical(scene))
    film = document["film"]
    parts = {
        "time": time + 0.0,
        "film": {key: film[key] for key in ("width", "height", "crop", "filter")},
        "max_bounces": document["integrator"]["max_bounces"],
        **{key: document[key] for key in _SEEN},
    }
    return "sha256:" + hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _canonical(scene: Scene) -> bytes:
    tables = ("textures", "materials", "prototypes")
    ordered = scene.model_copy(update={key: dict(sorted(getattr(scene, key).items())) for key in tables})
    return _NEGATIVE_ZERO.sub(b"0.0", ordered.model_dump_json().encode("utf-8"))
