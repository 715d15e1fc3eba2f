"""The light tree: its bounds hold what they bound, its probabilities are exactly how often it chooses, and no light that
can light a point is left out."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.geometry import compile_geometry
from penumbra_kernels.compile.light_bounds import LightBounds
from penumbra_kernels.compile.light_tree import build_light_tree
from penumbra_kernels.compile.lights import compile_lights
from penumbra_kernels.layout import CONSTANTS
from penumbra_scene.scene import Scene

Array = NDArray[Any]
_spec = importlib.util.spec_from_file_location("lights_lamps", Path(__file__).with_name("lamps.py"))
assert _spec is not None
assert _spec.loader is not None
kinds: Any = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(kinds)
LIGHTS, MOVE, SHAPES, STRETCH = kinds.LIGHTS, kinds.MOVE, kinds.SHAPES, kinds.STRETCH

NONE = CONSTANTS["NONE"]
LEAF = CONSTANTS["LEAF_FLAG"]
NUMBERS = 1 << 24
SHUTTER = {"open": 0, "close": 1}
SLIDE = {
    "keyframes": [
        {"time": 0, "transform": [{"rotate": {"axis": [0, 1, 0], "angle": 40}}]},
        {"time": 1, "transform": [{"rotate": {"axis": [0, 1, 0], "angle": 40}}, {"translate": [0, 2, 1]}]},
    ]
}
SKY = {"type": "constant", "radiance": 0.2}


def lamps(transform: Any, **more: Any) -> list[dict[str, Any]]:
    """The four kinds of shapes that emit, under a transform."""
    return [{**shape, "transform": transform, **more} for shape in SHAPES[1:]]


def instances(transform: Any) -> dict[str, Any]:
    return {
        "prototypes": {"lamps": lamps([{"translate": [0.5, 0, 0]}])},
        "shapes": [{"type": "instance", "prototype": "lamps", "transform": transform}],
    }


SCENES: dict[str, dict[str, Any]] = {
    "still": {"shapes": lamps([])},
    "mirrored": {"shapes": lamps([{"scale": [-1, 1, 1]}])},
    "stretched": {"shapes": lamps(STRETCH)},
    "turning": {"shapes": lamps(MOVE)},
    "sliding": {"shapes": lamps(SLIDE)},
    "instances": instances(STRETCH),
    "mirrored instances": instances([{"scale": [1, 1, -1]}, {"rotate": {"axis": [1, 0, 2], "angle": 70}}]),
    "instances that turn": instances(MOVE),
    "instances that slide": instances(SLIDE),
    "bodiless": {"lights": [*LIGHTS, {**LIGHTS[1], "direction": [1, 1, 0], "inner_cone_angle": 20}]},
    "bodiless, moving": {"lights": [{**light, "transform": MOVE} for light in LIGHTS]},
    "all under a sky": {
        "shapes": [*lamps([]), *lamps(SLIDE)],
        "lights": [*LIGHTS, *LIGHTS, {"type": "directional", "direction": [1, 0.5, 0]}],
        "environment": SKY,
    },
}


def compiled(keys: dict[str, Any], anchor: Any = (0.0, 0.0, 0.0)) -> tuple[Any, Any]:
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "perspective", "shutter": SHUTTER},
            "integrator": {"light_selection": "tree"},
            **keys,
        }
    )
    at = np.array(anchor, np.float64)
    geometry = compile_geometry(scene, NoAssets(), 0.0, at, {})
    return geometry, compile_lights(scene, geometry, 0.0, at, NoAssets())


def device_scene(bench: Any, geometry: Any, lights: Any) -> Any:
    """What the bench uploads, of a compiled scene."""
    names = [field.name for field in dataclasses.fields(bench.scene)]
    arrays = {**geometry.arrays, **lights.arrays}
    arrays["keyframes"] = np.concatenate([geometry.keyframes, lights.keyframes])
    arrays["lights"] = list(arrays["lights"])
    found = {name: arrays[name] for name in names if name in arrays}
    return bench.scene(**found, environment_light=lights.environment_light)


def receivers(count: int, seed: int) -> tuple[Array, Array]:
    """Points among and about the lamps, a quarter of them without a normal."""
    rng = np.random.default_rng(seed)
    p = rng.normal([0, 2, 0], 3.0, (count, 3)).astype(np.float32)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[::4] = 0.0
    return p, n.astype(np.float32)


def lamp_field(count: int, seed: int = 5, kind: str = "point") -> list[dict[str, Any]]:
    """Lamps of powers over six decades in a flat hall."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([-30, 2, -30], [30, 4, 30], (count, 3)).round(4)
    power = 10.0 ** rng.uniform(-3, 3, count)
    return [
        {"type": kind, "position": p.tolist(), "intensity": float(i)}
        for p, i in zip(places, power, strict=True)
    ]


@pytest.mark.parametrize("name", SCENES)
def test_probabilities_sum_to_one_exactly(bench: Any, name: str) -> None:
    geometry, lights = compiled(SCENES[name])
    scene = device_scene(bench, geometry, lights)
    p, n = receivers(300, 3)
    pmf = np.stack([bench.pmf(scene, np.full(300, i), p, n) for i in range(len(scene.lights))])
    steps = pmf.astype(np.float64) * NUMBERS
    assert np.array_equal(steps, np.rint(steps))
    assert np.array_equal(steps.sum(axis=0), np.full(300, NUMBERS))


@pytest.mark.parametrize("name", ["all under a sky", "instances that turn"])
def test_lights_are_chosen_exactly_as_often_as_their_probability_says(bench: Any, name: str) -> None:
    """All uniform numbers that there are, from points among the lamps and away from them."""
    geometry, lights = compiled(SCENES[name])
    scene = device_scene(bench, geometry, lights)
    count = len(scene.lights)
    for p, n in (([0.5, 2.0, 0.3], [0, 0, 0]), ([2.0, 0.0, 1.0], [0, 1, 0])):
        told = bench.pmf(scene, np.arange(count), p, n)
        tally = bench.tally(scene, p, n, told)
        assert np.array_equal(tally[:-1], told.astype(np.float64) * NUMBERS)
        assert tally[-1] == 0


def test_choices_follow_their_probabilities_among_thousands(bench: Any) -> None:
    """Chi-squared, and the probability told with each choice is the one told for its light."""
    geometry, lights = compiled({"lights": lamp_field(3000)})
    scene = device_scene(bench, geometry, lights)
    u = bench.uniform(200_000, 7, 1)[:, 0]
    for p, n in (([3, 3, 1], [0, 0, 0]), ([-20, 0, 8], [0, 1, 0])):
        light, told, again = bench.choose(scene, u, p, n)
        assert np.array_equal(told, again)
        pmf = bench.pmf(scene, np.arange(3000), p, n).astype(np.float64)
        assert bench.chi2_pvalue(np.bincount(light, minlength=3000), pmf * len(u)) > 1e-6


def test_the_numbers_of_a_light_are_left_as_points_all_over_it(bench: Any) -> None:
    """They are neighbours: the places left of them go from 0 to 1 in even steps, filled up by the second number's digits."""
    geometry, lights = compiled({"lights": lamp_field(3000)})
    scene = device_scene(bench, geometry, lights)
    numbers = np.arange(1_000_000, 1_400_000)
    light, left = bench.choose_points(
        scene, np.stack([numbers * 2.0**-24, np.full(len(numbers), 0.75 * 2.0**-12)], axis=-1), [3, 3, 1]
    )
    pieces = np.split(left[:, 0], np.flatnonzero(np.diff(light)) + 1)[
        1:-1
    ]  # the first and the last are cut off
    assert len(pieces) > 100
    for piece in pieces:
        assert np.allclose(piece, (np.arange(len(piece)) + 0.75) / len(piece), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_no_light_that_lights_a_point_is_left_out(bench: Any, name: str) -> None:
    """Whatever a light sends to a receiver's front, at any time, the tree may choose it."""
    geometry, lights = compiled(SCENES[name])
    scene = device_scene(bench, geometry, lights)
    p, n = receivers(2000, 11)
    u = bench.uniform(2000, 13, 3)
    lit = 0
    for index in range(len(scene.lights)):
        pmf = bench.pmf(scene, np.full(2000, index), p, n)
        for time in (0.0, 0.37, 1.0):
            samples = bench.sample(scene, p, u, index, time)
            front = n[samples.index]
            arrives = (np.einsum("ij,ij->i", samples.wi, front) > 0) | ~front.any(axis=1)
            arrives &= samples.radiance.max(axis=1) > 0
            assert (pmf[samples.index[arrives]] > 0).all()
            lit += int(arrives.sum())
    assert lit > 1000


def test_lights_that_cannot_light_a_point_are_left_out(bench: Any) -> None:
    """A one-sided quad from behind, a spot away from its cone, the sun from below, everything behind the receiver."""
    down = {
        "type": "quad",
        "origin": [-1, 3, -1],
        "u": [1, 0, 0],
        "v": [0, 0, 1],
        "emission": {"radiance": 1},
    }
    spot = {"type": "spot", "position": [0, 3, 0], "direction": [0, -1, 0], "outer_cone_angle": 20}
    sun = {"type": "directional", "direction": [0, -1, 0]}
    lamp = {"type": "point", "position": [0, 9, 0]}
    geometry, lights = compiled({"shapes": [down], "lights": [spot, sun, lamp]})
    scene = device_scene(bench, geometry, lights)

    def can(p: Any, n: Any = (0, 0, 0)) -> list[bool]:
        return (bench.pmf(scene, np.arange(4), p, n) > 0).tolist()

    assert can([-0.5, 1, -0.5]) == [True, True, True, True]
    assert can([-0.5, 5, -0.5]) == [False, False, True, True]
    assert can([8, 2, 0], [0, 1, 0]) == [True, False, True, True]
    assert can([8, 2, 0], [1, 0, 0]) == [False, False, True, False]
    # Nothing lights this one: any choice will do, as long as it is one.
    assert bench.pmf(scene, np.arange(4), [8, 2, 0], [0.8, -0.6, 0]).sum() == 1


@pytest.mark.parametrize("above", [True, False])
def test_far_lights_have_half_of_the_choice_where_near_ones_can_light(bench: Any, above: bool) -> None:
    geometry, lights = compiled({"lights": [*lamp_field(40), *LIGHTS[2:]], "environment": SKY})
    scene = device_scene(bench, geometry, lights)
    pmf = bench.pmf(scene, np.arange(42), [0, -200, 0], [0, 1 if above else -1, 0]).astype(np.float64)
    assert pmf[40:].sum() == pytest.approx(0.5 if above else 1.0, abs=1e-5)
    assert (pmf[40] > 0) == above
    assert pmf[41] > 0


def test_one_lamp_among_ten_thousand_is_found(bench: Any) -> None:
    """A lamp of the hall's mean power, 5 cm away: power alone chooses it once in ten thousand times."""
    field = lamp_field(10_000)
    power = float(np.mean([lamp["intensity"] for lamp in field]))
    field[1234] = {"type": "point", "position": [10, 1, 10], "intensity": power}
    geometry, lights = compiled({"lights": field})
    scene = device_scene(bench, geometry, lights)
    pmf = bench.pmf(scene, np.array([1234]), [10, 0.95, 10], [0, 1, 0])
    assert pmf[0] > 1000 * 1e-4
    chosen, _, _ = bench.choose(scene, bench.uniform(1000, 3, 1)[:, 0], [10, 0.95, 10], [0, 1, 0])
    assert np.mean(chosen == 1234) == pytest.approx(pmf[0], abs=0.1)


def test_lights_without_power_are_never_chosen_by_the_tree(bench: Any) -> None:
    dark = [{**lamp, "intensity": 0} if i % 3 else lamp for i, lamp in enumerate(lamp_field(50))]
    geometry, lights = compiled({"lights": dark})
    scene = device_scene(bench, geometry, lights)
    chosen, _, _ = bench.choose(scene, bench.uniform(20_000, 3, 1)[:, 0], [0, 3, 0])
    assert set(chosen.tolist()) <= set(range(0, 50, 3))
    pmf = bench.pmf(scene, np.arange(50), [0, 3, 0])
    assert np.array_equal(pmf > 0, np.arange(50) % 3 == 0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e38])
def test_points_that_are_none_choose_some_light(bench: Any, bad: float) -> None:
    geometry, lights = compiled({"lights": lamp_field(30)})
    scene = device_scene(bench, geometry, lights)
    for p, n in (([bad, 0, 0], [0, 1, 0]), ([0, 0, 0], [bad, 0, 0])):
        light, pmf, again = bench.choose(scene, bench.uniform(100, 3, 1)[:, 0], p, n)
        assert ((light >= 0) & (light < 30)).all()
        assert ((pmf > 0) & (pmf <= 1)).all()
        assert np.array_equal(pmf, again)


def test_at_a_lamp_itself_probabilities_stay_whole(bench: Any) -> None:
    field = lamp_field(30)
    geometry, lights = compiled({"lights": field})
    scene = device_scene(bench, geometry, lights)
    pmf = bench.pmf(scene, np.arange(30), field[7]["position"]).astype(np.float64)
    assert pmf.sum() == 1.0
    assert (pmf > 0).all()


def random_bounds(count: int, seed: int) -> list[LightBounds]:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return [
        LightBounds(
            rng.uniform(-10, 10, 3),
            float(rng.uniform(0, 0.5)),
            axes[i] if i % 3 else np.zeros(3),
            float(rng.uniform(0, 0.3)) if i % 3 else np.pi,
            float(rng.uniform(0.2, np.pi / 2)),
            float(10 ** rng.uniform(-6, 6)),
        )
        for i in range(count)
    ]


def lights_below(nodes: Array, word: int) -> list[int]:
    """Depth first, as places are given."""
    out: list[int] = []
    for child, count in zip(nodes[word]["child"], nodes[word]["count"], strict=True):
        if count:
            below = [int(child) - LEAF] if child & LEAF else lights_below(nodes, int(child))
            assert len(below) == count
            out += below
    return out


@pytest.mark.parametrize("count", [1, 2, 8, 9, 100, 1000])
def test_every_light_has_one_place_and_every_node_bounds_its_lights(count: int) -> None:
    bounds = random_bounds(count, count)
    tree = build_light_tree(bounds)
    order = lights_below(tree.nodes, 0)
    assert sorted(order) == list(range(count))
    assert np.array_equal(tree.leaf[order], np.arange(count))
    for node in tree.nodes:
        for lane in range(8):
            if not node["count"][lane]:
                assert node["strength"][lane] == 0
                continue
            child = int(node["child"][lane])
            below = [int(child) - LEAF] if child & LEAF else lights_below(tree.nodes, child)
            center = np.array([node[a][lane] for a in "xyz"], np.float64)
            axis = np.array([node[f"axis_{a}"][lane] for a in "xyz"], np.float64)
            spread = np.arccos(np.clip(float(node["cos_spread"][lane]), -1, 1))
            for light in below:
                b = bounds[light]
                assert np.linalg.norm(b.center - center) + b.radius <= node["radius"][lane] * (1 + 1e-6)
                off = np.arccos(np.clip(b.axis @ axis, -1, 1)) if b.axis.any() else 0.0
                assert min(off + b.spread, np.pi) <= spread + 1e-6
                assert np.cos(b.falloff) >= node["cos_falloff"][lane]


def test_lights_in_one_place_are_halved() -> None:
    bounds = [LightBounds(np.zeros(3), 0.0, np.zeros(3), np.pi, np.pi / 2, 1.0)] * 5000
    tree = build_light_tree(bounds)
    assert sorted(lights_below(tree.nodes, 0)) == list(range(5000))


def test_the_tree_is_the_same_every_time() -> None:
    a, b = (build_light_tree(random_bounds(700, 2)) for _ in range(2))
    assert a.nodes.tobytes() == b.nodes.tobytes()
    assert np.array_equal(a.leaf, b.leaf)
