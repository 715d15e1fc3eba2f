"""A search for hard cases that nobody thought of: random small scenes, and what has to hold for all of them.

Hypothesis picks the scenes, the same ones on every run of the suite; `make test-hard` searches on at random. What it finds
becomes a case with a number.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.materials import TILTED, MaterialBench, function_of
from penumbra_kernels.hardcases.benches.pictures import Renderer
from penumbra_kernels.hardcases.benches.transformed import transformed
from penumbra_kernels.hardcases.case import Z
from penumbra_kernels.hardcases.pictures import same_picture
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

FULL = os.environ.get("PENUMBRA_HARD_CASES", "fast") == "full"
SIDE = 16


def search(few: int, many: int) -> Any:
    """Hypothesis' settings: `few` scenes in the suite, always the same; `many` in the full setting."""
    return settings(
        max_examples=many if FULL else few,
        derandomize=not FULL,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.explicit, Phase.generate, Phase.shrink) if FULL else (Phase.explicit, Phase.generate),
    )


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers that hypothesis may make awkward: ends, small ones, whole ones."""
    return st.floats(low, high, allow_nan=False, allow_infinity=False, width=32)


UNIT = floats(0.0, 1.0)
SIGNED = floats(-2.0, 2.0)
POINT = st.tuples(SIGNED, SIGNED, SIGNED)
AXIS = POINT.filter(lambda v: sum(x * x for x in v) > 1e-3)
SIZE = st.sampled_from([1e-6, 1e-3, 0.1, 0.5, 1.0, 1.5, 100.0, 1e6])
COLOR = st.tuples(UNIT, UNIT, UNIT)
TRANSFORM = st.lists(
    st.one_of(
        st.builds(lambda v: {"translate": v}, POINT),
        st.builds(lambda a, d: {"rotate": {"axis": a, "angle": d}}, AXIS, floats(-360, 360)),
        st.builds(lambda s: {"scale": s}, st.tuples(*[st.sampled_from([-1.0, 0.001, 0.5, 1.0, 3.0])] * 3)),
    ),
    max_size=3,
)
# Tables of what microfacets lose are made anew for every roughness, in seconds: cases 22 and 23 have them.
SINGLE = {"energy_compensation": st.just(False)}
MATERIALS = {
    "diffuse": st.fixed_dictionaries({"type": st.just("diffuse"), "base_color": COLOR}),
    "phong": st.fixed_dictionaries({"type": st.just("phong"), "exponent": floats(0, 1e4)}),
    "mirror": st.just({"type": "mirror"}),
    "conductor": st.fixed_dictionaries(
        {"type": st.just("conductor"), "base_color": COLOR, "roughness": UNIT, "anisotropy": UNIT, **SINGLE}
    ),
    "plastic": st.fixed_dictionaries(
        {"type": st.just("plastic"), "roughness": UNIT, "ior": floats(1.0, 3.0), **SINGLE}
    ),
    "dielectric": st.fixed_dictionaries(
        {"type": st.just("dielectric"), "roughness": UNIT, "ior": floats(0.5, 3.0), **SINGLE}
    ),
    "thin_dielectric": st.fixed_dictionaries({"type": st.just("thin_dielectric"), "roughness": st.just(0.0)}),
    "diffuse_transmission": st.just({"type": "diffuse_transmission"}),
}
MATERIAL = st.one_of(*MATERIALS.values())
SHAPE = st.one_of(
    st.fixed_dictionaries({"type": st.just("sphere"), "center": POINT, "radius": SIZE}),
    st.fixed_dictionaries({"type": st.just("disc"), "center": POINT, "normal": AXIS, "radius": SIZE}),
    st.fixed_dictionaries({"type": st.just("quad"), "origin": POINT, "u": AXIS, "v": AXIS}).filter(
        lambda q: np.linalg.norm(np.cross(q["u"], q["v"])) > 1e-3
    ),
    st.fixed_dictionaries(
        {
            "type": st.just("mesh"),
            "positions": st.lists(POINT, min_size=4, max_size=4),
            "indices": st.just([[0, 1, 2], [0, 2, 3], [1, 1, 3]]),
        }
    ),
)
LIGHT = st.one_of(
    st.fixed_dictionaries({"type": st.just("point"), "position": POINT, "intensity": SIZE}),
    st.fixed_dictionaries({"type": st.just("directional"), "direction": AXIS}),
    st.fixed_dictionaries({"type": st.just("spot"), "position": POINT, "direction": AXIS}),
)
CAMERA = st.fixed_dictionaries(
    {
        "type": st.just("perspective"),
        "fov": floats(1.0, 120.0),
        "transform": st.just({"look_at": {"origin": [0.3, 0.7, 6.0], "target": [0.0, 0.1, 0.0]}}),
        "lens": st.fixed_dictionaries(
            {"aperture_radius": st.sampled_from([0.0, 1e-8, 0.1]), "focus_distance": SIZE}
        ),
    }
)


@st.composite
def scenes(draw: st.DrawFn) -> dict[str, Any]:
    """A scene of a few shapes, materials and lights, in JSON."""
    shapes = draw(st.lists(SHAPE, min_size=1, max_size=4))
    for shape in shapes:
        shape["material"] = draw(st.sampled_from(["a", "b"]))
        shape["transform"] = draw(TRANSFORM)
        if draw(st.booleans()):
            shape["emission"] = {"radiance": draw(SIZE), "two_sided": draw(st.booleans())}
    return {
        "version": 1,
        "camera": draw(CAMERA),
        "film": {"width": SIDE, "height": SIDE},
        "materials": {"a": draw(MATERIAL), "b": draw(MATERIAL)},
        "shapes": shapes,
        "lights": draw(st.lists(LIGHT, max_size=2)),
        "environment": draw(st.sampled_from([None, {"type": "constant", "radiance": 1}])),
        "integrator": {"max_bounces": 8},
        "sampler": {"type": "sobol", "seed": draw(st.integers(0, 2**32))},
    }


@pytest.fixture(scope="module")
def render(device: Device) -> Renderer:
    return Renderer(device)


@search(24, 1000)
@given(scene=scenes())
def test_every_picture_is_finite(render: Renderer, scene: dict[str, Any]) -> None:
    picture = render(scene, samples=32)
    assert np.isfinite(picture.mean).all()
    assert picture.mean.min() >= 0
    assert picture.node.sums["rejected"].sum() == 0
    assert (picture.node.sums["taken"] == 4).all()


WHITE = st.sampled_from(
    [
        {"type": "diffuse", "base_color": 1},
        {"type": "mirror"},
        {"type": "dielectric"},
        {"type": "thin_dielectric"},
        {"type": "conductor", "base_color": 1, "roughness": 0},
        {"type": "diffuse_transmission", "reflectance": 0.4, "transmittance": 0.6},
    ]
)


DEFAULT_IOR = 1.5


def _passive(shape: dict[str, Any], white: dict[str, Any]) -> dict[str, Any]:
    """The shape without light of its own, and without an inside unless it is closed: radiance in glass is ior^2 times what it
    is outside (Veach 1997, 5.2), so that a surface that light leaves and never entered shows more than the furnace holds."""
    kept = {key: value for key, value in shape.items() if key != "emission"}
    if shape["type"] != "sphere" and white[shape["material"]]["type"] == "dielectric":
        kept["material"] = "sheet"
    return kept


@search(12, 400)
@given(scene=scenes(), a=WHITE, b=WHITE)
def test_no_scene_makes_light_in_a_furnace(render: Renderer, scene: dict[str, Any], a: Any, b: Any) -> None:
    white = {"a": a, "b": b}
    furnace = {
        **scene,
        "shapes": [_passive(shape, white) for shape in scene["shapes"]],
        "materials": {**white, "sheet": {"type": "thin_dielectric"}},
        "lights": [],
        "environment": {"type": "constant", "radiance": 1},
        "integrator": {"max_bounces": 16},  # things without an opening would keep paths for ever
    }
    picture = render(furnace, samples=64)
    noise = Z * math.sqrt(picture.variance.sum()) / picture.mean.size * math.sqrt(3)
    # The camera may be in balls of glass, in each of which radiance is ior^2 times what it is outside.
    kinds = [furnace["materials"][shape["material"]]["type"] for shape in furnace["shapes"]]
    most = DEFAULT_IOR ** (2 * kinds.count("dielectric"))
    assert picture.mean.mean() - most < 1e-4 + noise


@pytest.fixture(scope="module")
def materials(device: Device) -> MaterialBench:
    return MaterialBench(device)


@search(24, 1000)
@given(
    material=MATERIAL.filter(lambda m: m["type"] != "mirror"),
    tilted=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_light_goes_both_ways_alike(materials: MaterialBench, material: Any, tilted: bool, seed: int) -> None:
    frame = TILTED if tilted else materials.FLAT
    wo, wi = materials.directions(4000, seed), materials.directions(4000, seed + 1)
    clear = (np.abs(wo @ np.asarray(frame[1])) > 0.05) & (np.abs(wi @ np.asarray(frame[1])) > 0.05)
    there = function_of(materials, material, frame, wo[clear], wi[clear])
    back = function_of(materials, material, frame, wi[clear], wo[clear])
    assert np.isfinite(there).all()
    assert (there >= 0).all()
    # A lobe of width alpha amplifies the rounding of directions by 1 / alpha^2.
    width = max(float(material.get("roughness", 1.0)), 0.1) ** 2
    error = np.abs(there - back) / np.maximum(np.maximum(there, back), 1.0)
    assert error.max() <= 1e-5 / width**2 * 10
    assert np.mean(error > 1e-5 / width**2) <= 2e-3


@search(12, 400)
@given(scene=scenes(), axis=AXIS, angle=floats(-180, 180), move=POINT, far=st.sampled_from([1.0, 1e3, 1e6]))
def test_a_rigid_motion_changes_no_picture(
    render: Renderer, scene: dict[str, Any], axis: Any, angle: float, move: Any, far: float
) -> None:
    moved = transformed(scene, rotate={"axis": axis, "angle": angle}, move=tuple(far * x for x in move))
    a, b = render(scene, samples=64), render(moved, samples=64)
    # Small bright things are met by few samples of a pixel: then its variance knows nothing of them.
    rare = max(a.mean.max(), b.mean.max()) > 100 * max(np.median(a.mean), np.median(b.mean), 1e-6)
    beyond = [m for m in same_picture("moved", a, b) if not m.passed and not (rare and "z" in m.what)]
    assert not beyond


@search(2, 60)
@given(scene=scenes())
def test_a_scenes_own_program_gives_the_generic_ones_bits(device: Device, scene: dict[str, Any]) -> None:
    compiled = compile_scene(Scene.model_validate(scene), NoAssets())
    nodes = [
        Tracer(device, compiled, SamplePlan(2, 4), program=program).trace(Tile(0, 0, SIDE, SIDE), 0, 4)
        for program in ("specialised", "generic")
    ]
    assert nodes[0].sums.tobytes() == nodes[1].sums.tobytes()
