"""Scenes without one of their effects: that one is gone, and nothing else than what hangs on it."""

from __future__ import annotations

from pathlib import Path

import pytest
from penumbra_kernels.features import EFFECTS, analyse
from penumbra_kernels.without import REMOVALS
from penumbra_scene.parse import parse_scene

SCENE = parse_scene(
    (Path(__file__).resolve().parents[2] / "examples" / "all_effects.json").read_bytes(), allow_files=True
)
DEPENDENT = {
    "time": {"instancing"},
    "area_lights": {"light_tree", "many_lights"},
    "delta_lights": {"light_tree", "many_lights"},
    "environment": {"environment_image", "light_tree", "many_lights"},
}
"""What may go with it."""


@pytest.mark.parametrize("name", REMOVALS)
def test_one_effect_is_taken_out_and_the_others_stay(name: str) -> None:
    effects, remove = REMOVALS[name]
    before = set(analyse(SCENE).present)
    after = set(analyse(remove(SCENE)).present)
    if not before.intersection(effects):
        assert after == before
    gone = before - after
    if name == "indirect":  # mirrors and panes show lights even without bounces
        assert gone == set()
        return
    assert not after.intersection(effects)
    assert gone <= set(effects) | DEPENDENT.get(name, set())
    assert after <= before


def test_most_effects_can_be_taken_out() -> None:
    removable = {effect for effects, _ in REMOVALS.values() for effect in effects}
    assert set(EFFECTS) - removable == {"instancing", "round", "many_lights", "environment_image"}
