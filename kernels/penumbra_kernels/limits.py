"""What a render of a scene does not cover: light that its paths cannot find, or find by chance alone.

Pure: looks at the scene alone. Paths start at the camera and are joined to lights by samples of the lights (Kajiya 1986), so
light that reaches a matt surface by way of a mirror or of clear glass, a caustic, is met only where a path runs into the
light by itself (Veach 1997, section 8.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from penumbra_scene.area import emits
from penumbra_scene.materials import Material
from penumbra_scene.scene import Scene

from penumbra_kernels.reach import placed_shapes, used_materials

SMOOTH_ROUGHNESS: Final = 0.01
"""Below it a microfacet surface is a perfect mirror or a clear pane (docs/numerics.md)."""
MATT: Final = frozenset({"diffuse", "diffuse_transmission", "phong"})
UNENDING: Final = 65535
"""max_bounces that leaves the end of paths to Russian roulette alone."""


@dataclass(frozen=True)
class Limit:
    """One thing that a render leaves out."""

    name: str
    reason: str


def not_covered(scene: Scene) -> tuple[Limit, ...]:
    """Everything that this scene's render leaves out, or finds by chance alone; empty where it is complete."""
    return tuple(_limits(scene))


def _limits(scene: Scene) -> Iterator[Limit]:
    materials = used_materials(scene).items()
    smooth = next((f"materials/{name}" for name, material in materials if _is_smooth(material)), None)
    if smooth is not None:
        yield from _caustics(scene, smooth)
    bounces = scene.integrator.max_bounces
    if bounces < UNENDING:
        yield Limit(
            "light of long paths",
            f"integrator/max_bounces is {bounces}: light that bounces more often is left out",
        )


def _caustics(scene: Scene, smooth: str) -> Iterator[Limit]:
    for i, light in enumerate(scene.lights):
        yield Limit(
            "caustics of lights without a body",
            f"lights/{i} is a {light.type} light and {smooth} is smooth: no path can meet that light by way of it",
        )
        break
    places = ("/".join(str(key) for key in path) for path, shape in placed_shapes(scene) if emits(shape))
    emitter = next(places, None)
    if scene.environment is not None and scene.environment.type == "image":
        emitter = emitter or "environment"
    if emitter is not None:
        yield Limit(
            "caustics of lights that no path has met",
            f"{emitter} emits and {smooth} is smooth: light by way of it is found by chance alone, the less often the "
            "smaller the light; what no path has met is in neither the picture nor its error bars",
        )


def _is_smooth(material: Material) -> bool:
    if material.type in MATT or material.type == "plastic":
        return False
    if material.type == "mirror":
        return True
    roughness = getattr(material, "roughness", 0.0)
    return isinstance(roughness, (int, float)) and roughness < SMOOTH_ROUGHNESS
