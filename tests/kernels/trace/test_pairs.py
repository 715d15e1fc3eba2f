"""Every effect alone, and every two together: the program that has just these gives the bits of the one that has all."""

from __future__ import annotations

import importlib.util
import itertools
import os
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.features import EFFECTS, analyse
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

_spec = importlib.util.spec_from_file_location("effect_scenes", Path(__file__).with_name("effect_scenes.py"))
assert _spec is not None
assert _spec.loader is not None
scenes: Any = importlib.util.module_from_spec(_spec)
sys.modules["effect_scenes"] = scenes
_spec.loader.exec_module(scenes)
WIDTH, HEIGHT = scenes.WIDTH, scenes.HEIGHT

IMPLIED = {"environment_image": {"environment"}, "motion": {"instancing"}, "light_tree": {"many_lights"}}
"""What an effect cannot be without."""
LIT = {"area_lights", "delta_lights", "many_lights", "environment"}

COVERING = scenes.covering(EFFECTS)
EVERY: Final = 1 if os.environ.get("PENUMBRA_ALL_PAIRS", "0") == "1" else 6
PAIRS = list(itertools.combinations(EFFECTS, 2))[::EVERY]
"""Pairs in scenes of their own, each with a program to build: all with `make pairs`, one in six in the suite, whose COVERING
has every two effects in and out in few scenes."""

DARK: dict[str, Any] = {
    "version": 1,
    "film": {"width": WIDTH, "height": HEIGHT},
    "camera": {"type": "perspective", "transform": scenes.TOWARDS},
    "materials": {"mirror": {"type": "mirror"}},
    "shapes": [
        {"type": "sphere", "center": [0.7, 1, 0], "radius": 0.8, "material": "mirror"},
        scenes.quad(-1.5),
    ],
    "integrator": {"max_bounces": 8},
}


def nodes(device: Device, scene: Scene) -> list[SumNode]:
    compiled = compile_scene(scene, scenes.Sky())
    tile = Tile(0, 0, WIDTH, HEIGHT)
    return [
        Tracer(device, compiled, SamplePlan(2, 4), program=program).trace(tile, 0, 4)
        for program in ("specialised", "generic")
    ]


def check(device: Device, effects: frozenset[str]) -> None:
    scene = scenes.scene_with(effects)
    special, generic = nodes(device, scene)
    assert special.sums["lit"].sum() > WIDTH * HEIGHT
    assert special.sums.tobytes() == generic.sums.tobytes()
    assert (special.layers is None) == (generic.layers is None) == ("layers" not in effects)
    if special.layers is not None and generic.layers is not None:
        assert special.layers.tobytes() == generic.layers.tobytes()


@pytest.mark.parametrize("effect", EFFECTS)
def test_scenes_have_just_the_effects_that_they_are_made_for(effect: str) -> None:
    found = set(analyse(scenes.scene_with([effect])).present)
    assert found - LIT == ({effect} | IMPLIED.get(effect, set())) - LIT
    assert effect in found


@pytest.mark.parametrize("effect", EFFECTS)
def test_one_effect_alone_gives_the_generic_programs_bits(device: Device, effect: str) -> None:
    check(device, frozenset({effect}))


@pytest.mark.parametrize("effects", COVERING, ids=range(len(COVERING)))
def test_every_pair_in_and_out_gives_the_generic_programs_bits(
    device: Device, effects: frozenset[str]
) -> None:
    check(device, effects)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_two_effects_alone_give_the_generic_programs_bits(device: Device, pair: tuple[str, str]) -> None:
    check(device, frozenset(pair))


def test_layers_change_no_bit_of_the_picture(device: Device) -> None:
    everything = frozenset(EFFECTS)
    with_layers, _ = nodes(device, scenes.scene_with(everything))
    without, _ = nodes(device, scenes.scene_with(everything - {"layers"}))
    assert with_layers.sums.tobytes() == without.sums.tobytes()


def test_without_a_light_no_program_looks_for_one(device: Device) -> None:
    """A case that the search for random scenes found: the generic program followed mirrors into the dark."""
    special, generic = nodes(device, Scene.model_validate(DARK))
    assert special.sums.tobytes() == generic.sums.tobytes()
    assert np.array_equal(generic.sums["rays"], generic.sums["taken"])


def test_the_sets_cover_every_pair_in_all_four_ways() -> None:
    for a, b in itertools.combinations(EFFECTS, 2):
        assert {(a in chosen, b in chosen) for chosen in COVERING} == set(
            itertools.product((False, True), repeat=2)
        )
    assert len(COVERING) < 16
