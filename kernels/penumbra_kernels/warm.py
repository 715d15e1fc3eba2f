"""The usual programs, by the effects that they have: what `penumbra warm` builds where it is given no scene.

They are those of the example scenes, under the default sampler, and the generic program.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from penumbra_scene.scene import Scene

from penumbra_kernels.features import EFFECTS, Feature, Features, analyse

DEFAULT_SAMPLER: Final = "sobol"

USUAL: Final[tuple[frozenset[str], ...]] = tuple(
    frozenset(words.split())
    for words in (
        "area_lights indirect",
        "round area_lights delta_lights many_lights",
        "round area_lights many_lights environment indirect",
        "round delta_lights many_lights environment indirect",
        "round delta_lights many_lights environment textures",
        "instancing round delta_lights many_lights environment indirect",
        "round area_lights delta_lights many_lights environment textures",
        "round area_lights many_lights environment gloss indirect",
        "round area_lights many_lights environment textures indirect",
        "round area_lights many_lights light_tree environment indirect",
        "round environment environment_image gloss transmission indirect",
        "round area_lights many_lights environment gloss textures indirect",
        "deformation round area_lights many_lights environment gloss textures indirect",
        "round area_lights many_lights environment gloss transmission textures indirect",
        "lens round area_lights many_lights light_tree environment gloss textures indirect",
        "motion instancing round area_lights many_lights environment gloss textures indirect",
        "camera_motion motion instancing round area_lights many_lights environment gloss textures indirect",
        "lens camera_motion motion deformation instancing round area_lights delta_lights many_lights"
        " environment environment_image gloss transmission textures indirect layers",
    )
)
"""Effects of a program each."""


def features_of(effects: Iterable[str]) -> Features:
    """The verdicts of some scene that has just these effects."""
    present = set(effects)
    verdicts = tuple(Feature(name, name in present, "usual") for name in EFFECTS)
    return Features(verdicts, DEFAULT_SAMPLER, area_sampling=False)


def programs_of(scenes: Iterable[tuple[str, Scene]]) -> Iterator[tuple[str, dict[str, int]]]:
    """(name, flags) of the generic programs, with which any scene can begin at once, and of those that scenes need; each
    once. Without scenes the usual ones."""
    found = [(name, analyse(scene)) for name, scene in scenes]
    if not found:
        found = [(" ".join(sorted(effects)) or "no effect", features_of(effects)) for effects in USUAL]
    every = [("generic", features.generic_flags()) for _, features in found]
    every += [(name, features.flags()) for name, features in found]
    seen = set()
    for name, flags in every:
        key = tuple(sorted(flags.items()))
        if key not in seen:
            seen.add(key)
            yield name, flags
