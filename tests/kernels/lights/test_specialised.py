"""Programs with just a scene's effects give the bits of the program that has them all."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from penumbra_kernels.compile.alias import alias_table
from penumbra_kernels.layout import SHAPE, TRIANGLE

NOTHING = {
    "PENUMBRA_AREA_LIGHTS": 0,
    "PENUMBRA_DELTA_LIGHTS": 0,
    "PENUMBRA_MANY_LIGHTS": 0,
    "PENUMBRA_LIGHT_TREE": 0,
    "PENUMBRA_ENVIRONMENT": 0,
    "PENUMBRA_ENVIRONMENT_IMAGE": 0,
    "PENUMBRA_MOTION": 0,
    "PENUMBRA_INSTANCING": 0,
}
FLAT = {"position": (-0.5, 1.0, -0.5), "direction": (1.0, 0.0, 0.0), "axis_v": (0.0, 0.0, 1.0)}

SCENES = {
    "quad": ({"AREA_LIGHTS"}, ["quad"]),
    "disc": ({"AREA_LIGHTS"}, ["disc"]),
    "sphere": ({"AREA_LIGHTS"}, ["sphere"]),
    "mesh": ({"AREA_LIGHTS"}, ["mesh"]),
    "point": ({"DELTA_LIGHTS"}, ["point"]),
    "spot": ({"DELTA_LIGHTS"}, ["spot"]),
    "directional": ({"DELTA_LIGHTS"}, ["directional"]),
    "constant sky": ({"ENVIRONMENT"}, ["environment"]),
    "quad and point": ({"AREA_LIGHTS", "DELTA_LIGHTS", "MANY_LIGHTS"}, ["quad", "point"]),
    "sphere under a sky": ({"AREA_LIGHTS", "ENVIRONMENT", "MANY_LIGHTS"}, ["sphere", "environment"]),
}


def record(bench, kind: str):
    if kind == "sphere":
        return bench.light(kind, position=(0, 3, 0), inner=1.0)
    if kind == "mesh":
        return bench.light(kind, shape=0, triangle_count=1, flags=1)
    return bench.light(kind, **FLAT, inner=1.0, outer=2.0)


def scene_of(bench, kinds: list[str]):
    triangles = np.zeros(1, TRIANGLE)
    triangles["vertex"] = [0, 1, 2]
    scene = bench.scene(
        [record(bench, kind) for kind in kinds],
        light_table=alias_table(np.arange(1.0, len(kinds) + 1)),
        emitter_cdf=np.array([0, 1], np.float32),
        shapes=np.zeros(1, SHAPE),
        triangles=triangles,
        positions=np.array([[0, 1, 0], [1, 1.5, 0], [0, 1, 1]], np.float32),
    )
    if kinds[-1] == "environment":
        scene.environment_light = len(kinds) - 1
    return scene


@pytest.mark.parametrize("name", SCENES)
def test_specialised_is_generic_bit_for_bit(bench, name: str) -> None:
    flags, kinds = SCENES[name]
    special = type(bench)(bench.device, {**NOTHING, **{f"PENUMBRA_{flag}": 1 for flag in flags}})
    scene = scene_of(bench, kinds)
    u = bench.uniform(3000, 71, 3)
    for index in range(len(kinds)):
        for p in ((0.1, 0.0, 0.2), (0.3, 0.9, 0.4), (50.0, -3.0, 0.0)):
            a, b = bench.sample(scene, p, u, index), special.sample(scene, p, u, index)
            for field in dataclasses.fields(a):
                assert np.array_equal(getattr(a, field.name), getattr(b, field.name)), field.name
            if len(a.pdf) and kinds[index] in ("quad", "disc", "sphere", "mesh"):
                given = (scene, p, a.wi, a.distance, a.n, 0, index)
                assert np.array_equal(bench.hit_pdf(*given), special.hit_pdf(*given))
    for x, y in zip(bench.choose(scene, u[:, 0]), special.choose(scene, u[:, 0]), strict=True):
        assert np.array_equal(x, y)
