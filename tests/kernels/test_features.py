"""Which effects a scene calls for, by table; and that the program's arguments follow its flags."""

from __future__ import annotations

import re
from typing import Any

import pytest
from penumbra_kernels.features import EFFECTS, analyse
from penumbra_kernels.program import CL_ROOT
from penumbra_kernels.tracer import ARGUMENTS
from penumbra_scene.scene import Scene

BASE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective"},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "quad"}],
}
LIT: dict[str, Any] = {"lights": [{"type": "point"}]}
"""Light to be carried on: without any there is none."""
DARK = {"type": "point", "intensity": 0}
SKY: dict[str, Any] = {"environment": {"type": "constant"}}
GLOW: dict[str, Any] = {"emission": {"radiance": 1}}
SHUTTER = {"open": 0.0, "close": 1.0}
MOVE = {"keyframes": [{"time": 0, "transform": []}, {"time": 1, "transform": [{"translate": [1, 0, 0]}]}]}
STRETCH = {
    "keyframes": [{"time": 0, "transform": []}, {"time": 1, "transform": [{"scale": [1, 2, 1]}]}],
}
TRIANGLE = {"positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "indices": [[0, 1, 2]]}


def shape(material: dict[str, Any]) -> dict[str, Any]:
    return {"materials": {"m": material}, "shapes": [{"type": "quad", "material": "m"}]}


CASES: list[tuple[str, dict[str, Any], set[str]]] = [
    ("a quad in the dark", {}, set()),
    ("an open lens", {"camera": {"type": "perspective", "lens": {"aperture_radius": 0.1}}}, {"lens"}),
    (
        "a camera that moves",
        {"camera": {"type": "perspective", "transform": MOVE, "shutter": SHUTTER}},
        {"camera_motion"},
    ),
    (
        "a camera that moves behind a closed shutter",
        {"camera": {"type": "perspective", "transform": MOVE}},
        set(),
    ),
    (
        "a shape that moves",
        {
            "camera": {"type": "perspective", "shutter": SHUTTER},
            "shapes": [{"type": "quad", "transform": MOVE}],
        },
        {"motion", "instancing"},
    ),
    (
        "keyframes that say the same",
        {
            "camera": {"type": "perspective", "shutter": SHUTTER},
            "shapes": [
                {
                    "type": "quad",
                    "transform": {"keyframes": [{"time": 0, "transform": []}, {"time": 1, "transform": []}]},
                }
            ],
        },
        set(),
    ),
    (
        "a mesh that deforms",
        {
            "camera": {"type": "perspective", "shutter": SHUTTER},
            "shapes": [
                {
                    "type": "mesh",
                    **TRIANGLE,
                    "deformation": [
                        {"time": 0, "positions": TRIANGLE["positions"]},
                        {"time": 1, "positions": [[0, 0, 1], [1, 0, 1], [0, 1, 1]]},
                    ],
                }
            ],
        },
        {"deformation"},
    ),
    (
        "an instance",
        {"prototypes": {"p": [{"type": "quad"}]}, "shapes": [{"type": "instance", "prototype": "p"}]},
        {"instancing"},
    ),
    ("a prototype that nobody uses", {"prototypes": {"p": [{"type": "sphere"}]}}, set()),
    ("a sphere", {"shapes": [{"type": "sphere"}]}, {"round"}),
    (
        "a stretched sphere",
        {"shapes": [{"type": "sphere", "transform": {"scale": [1, 2, 1]}}]},
        {"round", "instancing"},
    ),
    ("an area light", {"shapes": [{"type": "quad", "emission": {"radiance": 1}}]}, {"area_lights"}),
    ("a point light", {"lights": [{"type": "point"}]}, {"delta_lights"}),
    (
        "two lights",
        {"lights": [{"type": "point"}, {"type": "spot"}]},
        {"delta_lights", "many_lights", "light_tree"},
    ),
    (
        "two suns",
        {"lights": [{"type": "directional"}] * 2},
        {"delta_lights", "many_lights"},
    ),
    (
        "two suns and a tree",
        {
            "lights": [{"type": "directional"}] * 2,
            "integrator": {"max_bounces": 0, "light_selection": "tree"},
        },
        {"delta_lights", "many_lights", "light_tree"},
    ),
    (
        "a tree over one light",
        {"lights": [{"type": "point"}], "integrator": {"max_bounces": 0, "light_selection": "tree"}},
        {"delta_lights"},
    ),
    (
        "three lights beside a sun",
        {"lights": [*[{"type": "point"}] * 3, {"type": "directional"}]},
        {"delta_lights", "many_lights", "light_tree"},
    ),
    (
        "four lights under a sky",
        {"lights": [{"type": "point"}] * 4, **SKY},
        {"delta_lights", "many_lights", "environment"},
    ),
    (
        "five lights under a sky",
        {"lights": [{"type": "point"}] * 5, **SKY},
        {"delta_lights", "many_lights", "environment", "light_tree"},
    ),
    (
        "two lights beside a sun",
        {"lights": [{"type": "point"}, {"type": "spot"}, {"type": "directional"}]},
        {"delta_lights", "many_lights"},
    ),
    (
        "a sun and a sky",
        {"lights": [{"type": "directional"}], **SKY},
        {"delta_lights", "many_lights", "environment"},
    ),
    (
        "a light beside a sun and a sky",
        {"lights": [{"type": "point"}, {"type": "directional"}], **SKY},
        {"delta_lights", "many_lights", "environment", "light_tree"},
    ),
    (
        "a sky that gives no light is none",
        {"lights": [{"type": "point"}] * 3, "environment": {"type": "constant", "radiance": 0}},
        {"delta_lights", "many_lights", "light_tree"},
    ),
    (
        "four lights by power",
        {"lights": [{"type": "point"}] * 4, "integrator": {"max_bounces": 0, "light_selection": "power"}},
        {"delta_lights", "many_lights"},
    ),
    ("a sky", {"environment": {"type": "constant"}}, {"environment"}),
    (
        "an image of a sky",
        {"environment": {"type": "image", "image": {"file": "sky.exr"}}},
        {"environment", "environment_image"},
    ),
    ("gold", shape({"type": "conductor"}), {"gloss"}),
    ("gold in the light", {**LIT, **shape({"type": "conductor"})}, {"gloss", "delta_lights"}),
    (
        "polished gold",
        {**LIT, **shape({"type": "conductor", "roughness": 0})},
        {"gloss", "delta_lights", "indirect"},
    ),
    (
        "gold under a sky",
        {"environment": {"type": "constant"}, **shape({"type": "conductor"})},
        {"gloss", "environment", "indirect"},
    ),
    (
        "gold under a sky that light samples alone find",
        {
            "environment": {"type": "constant"},
            **shape({"type": "conductor"}),
            "integrator": {"max_bounces": 0, "mis": False},
        },
        {"gloss", "environment"},
    ),
    (
        "paper under a sky",
        {"environment": {"type": "constant"}, **shape({"type": "diffuse_transmission"})},
        {"transmission", "environment"},
    ),
    ("a mirror in the dark", shape({"type": "mirror"}), {"gloss"}),
    ("a mirror", {**LIT, **shape({"type": "mirror"})}, {"gloss", "delta_lights", "indirect"}),
    ("clear glass", shape({"type": "dielectric"}), {"transmission"}),
    (
        "clear glass in the light",
        {**LIT, **shape({"type": "dielectric"})},
        {"transmission", "delta_lights", "indirect"},
    ),
    ("glass too smooth to tell", shape({"type": "dielectric", "roughness": 0.005}), {"transmission"}),
    ("frosted glass", shape({"type": "dielectric", "roughness": 0.3}), {"gloss", "transmission"}),
    ("glass that bends nothing", shape({"type": "dielectric", "roughness": 0.3, "ior": 1}), {"transmission"}),
    ("a frosted sheet", shape({"type": "thin_dielectric", "roughness": 0.3}), {"gloss", "transmission"}),
    ("a cone without colour", shape({"type": "phong", "specular_color": 0}), set()),
    ("a leaf that nothing passes", shape({"type": "diffuse_transmission", "transmittance": 0}), set()),
    ("paper", shape({"type": "diffuse_transmission"}), {"transmission"}),
    ("glass that no shape is made of", {"materials": {"m": {"type": "dielectric"}}}, set()),
    (
        "a texture",
        {
            "textures": {"t": {"type": "checker"}},
            **shape({"type": "diffuse", "base_color": {"texture": "t"}}),
        },
        {"textures"},
    ),
    (
        "a texture that is one colour",
        {
            "textures": {"t": {"type": "constant", "color": 0.5}},
            **shape({"type": "diffuse", "base_color": {"texture": "t"}}),
        },
        set(),
    ),
    (
        "a texture of a material that no shape is made of",
        {
            "textures": {"t": {"type": "checker"}},
            "materials": {"m": {"type": "diffuse", "base_color": {"texture": "t"}}},
        },
        set(),
    ),
    ("bounces in the dark", {"integrator": {"max_bounces": 3}}, set()),
    ("bounces", {**LIT, "integrator": {"max_bounces": 3}}, {"indirect", "delta_lights"}),
    (
        "bounces between black walls",
        {**LIT, **shape({"type": "diffuse", "base_color": 0}), "integrator": {"max_bounces": 3}},
        {"delta_lights"},
    ),
    (
        "bounces between lamps alone",
        {"shapes": [{"type": "quad", "emission": {"radiance": 1}}], "integrator": {"max_bounces": 3}},
        {"area_lights"},
    ),
    ("a point light without power", {"lights": [DARK]}, set()),
    ("one of two lights without power", {"lights": [DARK, {"type": "spot"}]}, {"delta_lights"}),
    (
        "a moving light without power",
        {"lights": [{**DARK, "transform": MOVE}], "camera": {"type": "perspective", "shutter": SHUTTER}},
        set(),
    ),
    ("a lamp without power", {"shapes": [{"type": "quad", "emission": {"radiance": 0}}]}, set()),
    ("a black sky", {"environment": {"type": "constant", "radiance": 0}}, set()),
    (
        "an image of a sky, scaled to nothing",
        {"environment": {"type": "image", "image": {"file": "sky.exr"}, "scale": 0}},
        set(),
    ),
    (
        "a shape that has moved before the shutter opens",
        {
            "camera": {"type": "perspective", "shutter": {"open": 2.0, "close": 3.0}},
            "shapes": [{"type": "quad", "transform": MOVE}],
        },
        set(),
    ),
    (
        "a sphere that was stretched before the shutter opens",
        {
            "camera": {"type": "perspective", "shutter": {"open": 2.0, "close": 3.0}},
            "shapes": [{"type": "sphere", "transform": STRETCH}],
        },
        {"round", "instancing"},
    ),
    (
        "a mesh that deforms after the shutter closes",
        {
            "camera": {"type": "perspective", "shutter": {"open": 0.0, "close": 0.25}},
            "shapes": [
                {
                    "type": "mesh",
                    **TRIANGLE,
                    "deformation": [
                        {"time": 0, "positions": TRIANGLE["positions"]},
                        {"time": 0.5, "positions": TRIANGLE["positions"]},
                        {"time": 1, "positions": [[0, 0, 1], [1, 0, 1], [0, 1, 1]]},
                    ],
                }
            ],
        },
        set(),
    ),
    (
        "emitters without an area",
        {
            "shapes": [
                {
                    "type": "mesh",
                    "positions": [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
                    "indices": [[0, 1, 2]],
                    **GLOW,
                },
                {
                    "type": "quad",
                    "u": [1e-18, 0, 0],
                    "v": [0, 1e-18, 0],
                    "transform": {"scale": 0.01},
                    **GLOW,
                },
            ]
        },
        set(),
    ),
    (
        "a lamp beside emitters without an area: there is nothing to choose",
        {
            "shapes": [
                {"type": "quad", **GLOW},
                *({"type": "disc", "radius": 1e-25, **GLOW} for _ in range(4)),
            ]
        },
        {"round", "area_lights"},
    ),
    ("layers", {"film": {"layers": ["normal"]}}, {"layers"}),
]


@pytest.mark.parametrize(("change", "expected"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_only_the_effects_that_the_scene_calls_for(change: dict[str, Any], expected: set[str]) -> None:
    features = analyse(Scene.model_validate({**BASE, **change}))
    assert set(features.present) == expected
    assert all(v.reason for v in features.verdicts)
    assert {v.name for v in features.verdicts if v.pointer is not None} == expected


def test_pointers_lead_to_what_calls_for_an_effect() -> None:
    scene = {
        **BASE,
        **shape({"type": "dielectric"}),
        "materials": {"a/b": {"type": "dielectric"}},
        "shapes": [{"type": "quad", "material": "a/b"}],
        "lights": [DARK, {"type": "point", "name": "key"}],
    }
    verdicts = {v.name: v for v in analyse(Scene.model_validate(scene)).verdicts}
    assert verdicts["transmission"].pointer == "/materials/a~1b"
    assert verdicts["delta_lights"].pointer == "/lights/1"
    assert verdicts["delta_lights"].reason == "lights/1 (key) is a point light"


def test_every_verdict_says_where() -> None:
    features = analyse(Scene.model_validate({**BASE, **shape({"type": "dielectric"})}))
    assert next(v.reason for v in features.verdicts if v.name == "transmission") == "materials/m transmits"


def test_large_trees_are_those_of_meshes_from_assets_and_of_many_things() -> None:
    def of(*shapes: dict[str, Any]) -> dict[str, int]:
        return analyse(Scene.model_validate({**BASE, "shapes": list(shapes)})).flags()

    ball, mesh = (
        {"type": "sphere", "radius": 1},
        {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]},
    )
    assert not of(*[ball] * 256)["PENUMBRA_LARGE_TREES"]
    assert of(*[ball] * 257)["PENUMBRA_LARGE_TREES"]
    assert not of({**mesh, "indices": [[0, 1, 2]] * 256})["PENUMBRA_LARGE_TREES"]
    assert of({**mesh, "indices": [[0, 1, 2]] * 255}, {"type": "quad"})["PENUMBRA_LARGE_TREES"]
    assert of({"type": "mesh", "source": {"asset": "sha256:" + 64 * "0"}})["PENUMBRA_LARGE_TREES"]
    assert analyse(Scene.model_validate(BASE)).generic_flags()["PENUMBRA_LARGE_TREES"]


def test_flags_are_numbers_for_every_effect() -> None:
    features = analyse(Scene.model_validate(BASE))
    for flags in (features.flags(), features.generic_flags()):
        assert {f"PENUMBRA_{e.upper()}" for e in EFFECTS} <= flags.keys()
        assert all(isinstance(v, int) for v in flags.values())


def test_the_host_passes_the_kernels_arguments_in_their_order() -> None:
    text = (CL_ROOT / "trace.cl").read_text()
    signature = text[text.index("__kernel void trace(") :]
    signature = signature[: signature.index(") {")]
    names = re.findall(r"(\w+)\s*[,\n]|(\w+)$", re.sub(r"#[^\n]*", ",", signature.split("(", 1)[1]))
    assert [a or b for a, b in names if (a or b)] == [name for name, _ in ARGUMENTS]
