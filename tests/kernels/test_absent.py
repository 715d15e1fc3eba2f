"""An effect that is out is not there: no code, no data, no random numbers."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.accel.binary import SWEEP_LIMIT
from penumbra_kernels.assets import Image, MeshData, NoAssets
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_kernels.compiler import is_cached
from penumbra_kernels.device import Device
from penumbra_kernels.dimensions import numbers_drawn
from penumbra_kernels.features import EFFECTS, Features, analyse
from penumbra_kernels.layout import CONSTANTS
from penumbra_kernels.nodes import Tile
from penumbra_kernels.program import assemble, settle
from penumbra_kernels.sensitivity import GROUPS, bit_of, groups_of
from penumbra_kernels.tracer import ARGUMENTS, SamplePlan, Tracer, build_program
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene

DEVICE = {"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_COMPACT_TREE": 0, "PENUMBRA_BUILTINS": 1, "PENUMBRA_X86": 1}

FUNCTIONS: dict[str, set[str]] = {
    "lens": {"lens_point"},
    "camera_motion": {"keyframe_matrix", "camera_time"},
    "motion": {"keyframe_matrix", "camera_time"},
    "deformation": {"hit_deforming", "camera_time"},
    "instancing": {"enter_instance"},
    "round": {"sphere_distance", "disc_distance", "hit_planes"},
    "area_lights": {"quad_light_sample", "disc_light_sample", "sphere_light_sample", "mesh_light_sample"},
    "delta_lights": {"point_light_sample", "spot_light_sample", "directional_light_sample"},
    "light_tree": {"light_tree_choose", "light_tree_pmf"},
    "environment": {"environment_sample", "environment_radiance"},
    "gloss": {"phong_eval", "conductor_eval", "plastic_eval", "mirror_sample"},
    "transmission": {"dielectric_sample", "thin_dielectric_sample", "diffuse_transmission_eval"},
    "textures": {"texture_lookup"},
    "indirect": {"bsdf_sample", "roulette"},
    "layers": {"bsdf_albedo", "object_of"},
}
"""Code that only this effect, or this one with others, has any use for. many_lights has no function of its own, and what
reads an environment's image stands behind a question that is answered `false` where there is none."""

BUFFERS: dict[str, set[str]] = {
    "camera_motion": {"keyframes", "shutter_table"},
    "motion": {"keyframes", "shutter_table"},
    "deformation": {"times", "shutter_table"},
    "instancing": {"instances"},
    "round": {"spheres", "discs", "planes"},
    "area_lights": {"emitter_cdf"},
    "many_lights": {"light_table"},
    "light_tree": {"light_nodes"},
    "environment": {"environment"},
    "gloss": {"albedo_table"},
    "textures": {"textures", "texels"},
    "layers": {"layers"},
}
NEEDS: dict[str, set[str]] = {
    "light_tree": {"many_lights", "area_lights"},
    "gloss": {"indirect"},
    "transmission": {"indirect"},
}
"""Without which some of an effect's code has no use."""


def flags_of(*effects: str) -> dict[str, int]:
    flags = {f"PENUMBRA_{name.upper()}": int(name in effects) for name in EFFECTS}
    return {
        **flags,
        "PENUMBRA_SAMPLER": 5,
        "PENUMBRA_LIGHT_AREA_SAMPLING": 0,
        "PENUMBRA_ADAPTIVE": 0,
        "PENUMBRA_LARGE_TREES": 0,
        "PENUMBRA_TOGETHER": 1,
        **DEVICE,
    }


def _value(expression: str, macros: dict[str, str]) -> bool:
    """Of an #if: integers, macros, ! && || and comparisons."""
    text = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda m: str(int(m[1] in macros)), expression)
    for _ in range(4):
        text = re.sub(r"\b[A-Za-z_]\w*", lambda m: macros.get(m[0], "0"), text)
        text = re.sub(r"\b(\d+)u\b", r"\1", text)
    text = text.replace("&&", " and ").replace("||", " or ")
    return bool(eval(re.sub(r"!(?!=)", " not ", text), {"__builtins__": {}}))


def preprocessed(source: str) -> str:
    """What of a program's text the compiler sees; macros are not expanded, only conditions decided."""
    macros = {"__AVX__": "1", "__FMA__": "1"}
    out, stack = [], [(True, True)]  # (this branch is seen, no branch of this #if was yet)
    for line in source.replace("\\\n", " ").splitlines():
        word, _, rest = line.strip().partition(" ")
        rest = rest.split("//")[0].strip()
        seen = all(shown for shown, _ in stack)
        if word in ("#if", "#ifdef", "#ifndef"):
            test = {"#if": rest, "#ifdef": f"defined({rest})", "#ifndef": f"!defined({rest})"}[word]
            taken = seen and _value(test, macros)
            stack.append((taken, not taken))
        elif word == "#elif":
            _, open_ = stack.pop()
            taken = open_ and all(shown for shown, _ in stack) and _value(rest, macros)
            stack.append((taken, open_ and not taken))
        elif word == "#else":
            _, open_ = stack.pop()
            stack.append((open_, False))
        elif word == "#endif":
            stack.pop()
        elif seen and word == "#define" and "(" not in rest.split()[0]:
            name, _, value = rest.partition(" ")
            macros[name] = value.strip() or "1"
            out.append(line)
        elif seen:
            out.append(line)
    return "\n".join(out)


def reachable(source: str) -> set[str]:
    """Functions, and function-like macros, that the kernel can call, by their names."""
    text = re.sub(r"//[^\n]*|^#line[^\n]*", "", preprocessed(source), flags=re.MULTILINE)
    bodies: dict[str, str] = {}
    code = re.sub(r"^#define[^\n]*", "", text, flags=re.MULTILINE)
    for match in re.finditer(r"\b(\w+)\s*\(([^;{}]*)\)\s*\{", code):
        depth, end = 1, match.end()
        while depth:
            depth += {"{": 1, "}": -1}.get(code[end], 0)
            end += 1
        if match[1] not in ("if", "for", "while", "switch"):
            bodies.setdefault(match[1], code[match.end() : end])
    for match in re.finditer(r"#define (\w+)(?:\([^)]*\))? ([^\n]*)", text):
        bodies.setdefault(match[1], match[2])
    found, todo = set(), ["trace"]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += [word for word in set(re.findall(r"\w+", bodies[name])) if word in bodies]
    return found


def test_the_evaluator_reads_conditions_as_a_preprocessor_does() -> None:
    inner = "#if B\nno\n#elif A == 1u\ny\n#else\nno\n#endif"
    text = f"#define A 1\n#define B 0\n#if A && !B\nx\n{inner}\n#else\nno\n#endif\n#ifdef C\nno\n#endif"
    assert preprocessed(text).split("\n")[2:] == ["x", "y"]


@pytest.mark.parametrize("effect", FUNCTIONS)
def test_code_of_an_effect_is_in_programs_that_have_it_and_in_no_other(effect: str) -> None:
    rivals = {
        name for name, functions in FUNCTIONS.items() if name != effect and functions & FUNCTIONS[effect]
    }
    without = [name for name in EFFECTS if name not in rivals | {effect}]
    have = {effect, "delta_lights"} | NEEDS.get(effect, set())
    for compact in (0, 1):
        one = {"PENUMBRA_COMPACT_TREE": compact}
        absent = reachable(assemble("trace.cl", flags_of(*without) | one))
        present = reachable(assemble("trace.cl", flags_of(*have) | one))
        for function in FUNCTIONS[effect]:
            forms = {function, f"{function}16"}
            assert not forms & absent
            assert forms & present


def test_a_program_without_bounces_has_no_loop_over_them() -> None:
    source = preprocessed(assemble("trace.cl", flags_of("delta_lights")))
    body = source[source.index("Mask16 scatter16(") :]
    body = body[: body.index("\n}")]
    assert "SLOT_DIRECTION" not in body
    assert "spawn_ray" not in body


def test_lights_and_mirrors_without_extent_draw_no_points_and_no_directions() -> None:
    assert "sobol_2d" in reachable(assemble("trace.cl", flags_of("delta_lights")))  # the pixel's
    only = preprocessed(assemble("trace.cl", flags_of("delta_lights")))
    extent = only[only.index("bool light_has_extent(") :]
    assert extent[: extent.index("}")].count("return false;") == 1
    assert "return true" not in extent[: extent.index("}")]


@pytest.mark.parametrize("effect", BUFFERS)
def test_data_of_an_effect_that_is_out_has_no_buffer(effect: str) -> None:
    def buffers(*effects: str) -> set[str]:
        flags = flags_of(*effects)
        return {name for name, present in ARGUMENTS if present(flags)}

    rivals = {name for name, needed in BUFFERS.items() if name != effect and needed & BUFFERS[effect]}
    assert not BUFFERS[effect] & buffers(*(e for e in EFFECTS if e not in rivals | {effect}))
    assert BUFFERS[effect] <= buffers(effect)


SHUTTER = {"open": 0, "close": 1}
MOVE = {"keyframes": [{"time": t, "transform": [{"translate": [t, 0, 0]}]} for t in (0, 1)]}


class Heap:
    """Assets that hold one mesh: loose triangles, enough for a tree that is binned."""

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        count = 2 * SWEEP_LIMIT
        corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.uniform(-0.02, 0.02, (count, 3, 3))
        self._mesh = MeshData(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), None, None)

    def mesh(self, ref: AssetRef) -> MeshData:
        return self._mesh

    def image(self, ref: AssetRef) -> Image:
        raise AssertionError(f"{ref} is no image of this scene")


def heap(*others: dict[str, Any]) -> CompiledScene:
    """Many still triangles and other shapes, the shutter open."""
    scene = {
        "version": 1,
        "camera": {"type": "perspective", "shutter": SHUTTER},
        "shapes": [{"type": "mesh", "source": {"file": "heap.ply"}}, *others],
        "lights": [{"type": "point"}],
    }
    return compile_scene(Scene.model_validate(scene), Heap())


SQUARE = {"type": "quad", "origin": [3, 0, 0]}


def test_one_moving_object_costs_its_own_keyframes_and_leaves_the_still_tree() -> None:
    alone, moving = heap(), heap({**SQUARE, "transform": MOVE})
    assert len(moving.arrays["keyframes"]) == 2
    assert len(moving.arrays["instances"]) == 1
    for name, fields in (("packets", ["v0", "v1", "v2"]), ("nodes", ["lo_x", "hi_x", "lo_y", "hi_y"])):
        have = {tuple(record[f].tobytes() for f in fields) for record in moving.arrays[name]}
        assert all(tuple(record[f].tobytes() for f in fields) in have for record in alone.arrays[name]), name
        assert len(moving.arrays[name]) <= len(alone.arrays[name]) + 3


def test_a_still_scene_has_no_keyframe() -> None:
    still = heap(SQUARE)
    assert len(still.arrays["keyframes"]) == 0
    assert len(still.arrays["instances"]) == 0
    assert not {"motion", "camera_motion", "instancing"} & set(still.features.present)


def drawn(scene: dict[str, Any]) -> tuple[Features, tuple[int, int]]:
    features = analyse(Scene.model_validate({"version": 1, **scene}))
    return features, numbers_drawn(features)


PLAIN: dict[str, Any] = {
    "camera": {"type": "perspective"},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "quad", "origin": [-1, -1, -3], "u": [2, 0, 0], "v": [0, 2, 0]}],
    "lights": [{"type": "point"}],
}


@pytest.mark.parametrize(
    ("change", "numbers"),
    [
        ({}, (2, 0)),
        ({"camera": {"type": "perspective", "lens": {"aperture_radius": 1}}}, (4, 0)),
        ({"camera": {"type": "perspective", "transform": MOVE, "shutter": SHUTTER}}, (3, 0)),
        ({"lights": [{"type": "point"}] * 2}, (2, 2)),
        ({"environment": {"type": "constant"}}, (2, 2)),
        ({"integrator": {"max_bounces": 1}}, (2, 3)),
    ],
    ids=["plain", "lens", "time", "two lights", "a sky and a light", "bounces"],
)
def test_numbers_that_are_drawn(change: dict[str, Any], numbers: tuple[int, int]) -> None:
    assert drawn({**PLAIN, **change})[1] == numbers


def test_groups_that_are_out_change_no_bit_when_drawn_anew(device: Device) -> None:
    scene = {"version": 1, **PLAIN, "film": {"width": 16, "height": 16}}
    compiled = compile_scene(Scene.model_validate(scene), NoAssets())
    assert groups_of(compiled.features) == ("pixel",)
    tracer = Tracer(device, compiled, SamplePlan(2, 4), measuring=True)

    def bits(groups: int) -> bytes:
        tracer.other_groups = groups
        return tracer.trace(Tile(0, 0, 16, 16), 0, 4).sums.tobytes()

    first = bits(0)
    assert bits(sum(bit_of(group) for group in GROUPS if group != "pixel")) == first
    assert bits(bit_of("pixel")) != first


ONLY_LANES = {"PENUMBRA_TOGETHER": 1, "PENUMBRA_LARGE_TREES": 1}


def code(flags: dict[str, int]) -> str:
    """What a compiler sees, without what the flags themselves are defined as."""
    return re.sub(
        r"^#define PENUMBRA_(TOGETHER|LARGE_TREES)\b.*\n",
        "",
        preprocessed(assemble("trace.cl", flags)),
        flags=re.M,
    )


@pytest.mark.parametrize(
    ("kind", "reads"),
    [
        ({}, True),
        ({"PENUMBRA_DEVICE_GPU": 1}, False),
        ({"PENUMBRA_COMPACT_TREE": 1}, False),
        ({"PENUMBRA_SAMPLER": CONSTANTS["SAMPLER_RANDOM"]}, False),
        ({"PENUMBRA_TOGETHER": 0}, False),
    ],
)
def test_flags_that_only_lanes_read_make_one_program_without_lanes(kind: dict[str, int], reads: bool) -> None:
    flags = flags_of("round", "indirect") | ONLY_LANES | kind
    small = flags | {"PENUMBRA_LARGE_TREES": 0}
    assert (settle(flags) == flags) is reads
    assert (settle(flags) == settle(small)) is not reads
    assert (code(flags) == code(small)) is not reads
    assert code(settle(flags)) == code(flags)


def test_a_device_without_lanes_builds_one_program_for_trees_of_all_sizes(device: Device) -> None:
    compact = Device(device.info.id, tree="compact")
    flags = analyse(Scene.model_validate({"version": 1, "camera": {"type": "perspective"}})).flags()
    build_program(compact, flags | {"PENUMBRA_LARGE_TREES": 1})
    assert is_cached(compact, flags | {"PENUMBRA_LARGE_TREES": 0})
    assert is_cached(compact, flags | {"PENUMBRA_TOGETHER": 0})
