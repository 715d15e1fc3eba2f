"""Programs that are built before anybody waits for them: those of given scenes, or the usual ones.

The usual ones have the effects of the example scenes; the generic ones have all, and any scene can begin with them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, get_args

from penumbra_scene.scene import Scene
from penumbra_scene.settings import Sampler

from penumbra_kernels.features import EFFECTS, Feature, Features, analyse

DEFAULT_SAMPLER: Final = "sobol"
SAMPLERS: Final[tuple[str, ...]] = get_args(Sampler.model_fields["type"].annotation)

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

LARGE: Final[tuple[frozenset[str], ...]] = tuple(
    frozenset(words.split())
    for words in (
        "round area_lights many_lights environment gloss indirect",
        "round area_lights many_lights light_tree environment indirect",
        "deformation round area_lights many_lights environment gloss textures indirect",
        "motion instancing round area_lights many_lights environment gloss textures indirect",
    )
)
"""Those of them that there is one more of, for large trees."""


def features_of(
    effects: Iterable[str], sampler: str = DEFAULT_SAMPLER, *, adaptive: bool = False, large: bool = False
) -> Features:
    """The verdicts of some scene that has just these effects."""
    present = set(effects)
    verdicts = tuple(Feature(name, name in present, "usual") for name in EFFECTS)
    return Features(verdicts, sampler, area_sampling=False, adaptive=adaptive, large_trees=large)


def _generic(sampler: str) -> Iterator[tuple[str, dict[str, int]]]:
    """The generic programs under a sampler: layers and adaptive sampling change what is written, so they have their own."""
    for adaptive in (False,) if sampler == "random" else (False, True):  # it has no counts to adapt
        for layers in (False, True):
            words = ["generic", sampler, *["adaptive"] * adaptive, *["layers"] * layers]
            features = features_of(["layers"] * layers, sampler, adaptive=adaptive)
            yield ", ".join(words), features.generic_flags()


def _usual(sampler: str) -> Iterator[tuple[str, dict[str, int]]]:
    for effects in USUAL:
        yield f"{sampler}: {' '.join(sorted(effects))}", features_of(effects, sampler).flags()
    for effects in LARGE:
        words = ["large trees", *sorted(effects)]
        yield f"{sampler}: {', '.join(words)}", features_of(effects, sampler, large=True).flags()


def usual_programs(samplers: Sequence[str] = ()) -> Iterator[tuple[str, dict[str, int]]]:
    """(name, flags) of the generic programs and of the usual ones under these samplers. Without any named: of the default one,
    then the plain generic program of every other, so that any scene can begin at once."""
    for sampler in samplers or (DEFAULT_SAMPLER,):
        yield from _generic(sampler)
    for sampler in samplers or (DEFAULT_SAMPLER,):
        yield from _usual(sampler)
    if not samplers:
        for sampler in SAMPLERS:
            if sampler != DEFAULT_SAMPLER:
                yield next(_generic(sampler))


def programs_of(scenes: Iterable[tuple[str, Scene]]) -> Iterator[tuple[str, dict[str, int]]]:
    """(name, flags) of the generic programs, with which these scenes can begin at once, and of those that they need; each
    once."""
    found = [(name, analyse(scene)) for name, scene in scenes]
    every = [("generic", features.generic_flags()) for _, features in found]
    every += [(name, features.flags()) for name, features in found]
    seen = set()
    for name, flags in every:
        key = tuple(sorted(flags.items()))
        if key not in seen:
            seen.add(key)
            yield name, flags
