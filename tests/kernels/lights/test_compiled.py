"""Lights from scene to device: records, powers, the choice; shadow rays reach their light, hits know it."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.accel.compact import tree_arrays
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.extent import scene_radius
from penumbra_kernels.compile.geometry import compile_geometry
from penumbra_kernels.compile.lights import compile_lights
from penumbra_kernels.features import analyse
from penumbra_kernels.layout import CONSTANTS
from penumbra_scene.scene import Scene

_spec = importlib.util.spec_from_file_location("lights_lamps", Path(__file__).with_name("lamps.py"))
assert _spec is not None
assert _spec.loader is not None
kinds: Any = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(kinds)
LIGHTS, MOVE, SHAPES, STRETCH = kinds.LIGHTS, kinds.MOVE, kinds.SHAPES, kinds.STRETCH

NONE = CONSTANTS["NONE"]
FAR = [1e5, -2e5, 3e5]


def scene_of(**parts) -> Scene:
    base = {"version": 1, "camera": {"type": "perspective"}}
    return Scene.model_validate({**base, **parts})


def compiled(scene: Scene, anchor=(0.0, 0.0, 0.0)):
    at = np.array(anchor)
    geometry = compile_geometry(scene, NoAssets(), 0.0, at, {})
    return geometry, compile_lights(scene, geometry, 0.0, at, NoAssets())


def test_records_shapes_and_powers_belong_together() -> None:
    scene = scene_of(shapes=SHAPES, lights=LIGHTS, environment={"type": "constant", "radiance": 0.1})
    geometry, lights = compiled(scene)
    records = lights.arrays["lights"]
    assert lights.light_count == 7
    assert lights.environment_light == 7
    assert np.array_equal(records["type"], [3, 4, 5, 6, 0, 1, 2, 7])
    assert np.array_equal(geometry.arrays["shapes"]["light"], [NONE, 0, 1, 2, 3])
    assert np.array_equal(records["shape"][:4], [1, 2, 3, 4])
    areas = [1.0, math.pi * 0.49, 4 * math.pi * 0.16, 0.5 + 1.0]
    assert np.allclose(records["area"][:4], areas, rtol=1e-6)
    disc = math.pi * scene_radius(geometry) ** 2
    powers = [math.pi * a * s for a, s in zip(areas, (1, 2, 1, 1), strict=True)]
    powers += [4 * math.pi * 3, 2 * math.pi * 6 * 0.25, 0.5 * disc, 0.1 * 4 * math.pi * disc]
    near, far = np.array(powers[:-2]), np.array(powers[-2:])  # half of the choice each
    pmf = 0.5 * np.concatenate([near / near.sum(), far / far.sum()])
    assert np.allclose(records["pmf"], pmf, rtol=1e-5)
    assert np.array_equal(records["pmf"], lights.arrays["light_table"]["pmf"])
    assert np.allclose(records["direction"][6], [0, -0.6, 0.8])
    assert np.allclose(np.diff(lights.arrays["emitter_cdf"]), [1 / 3, 2 / 3], atol=1e-6)


@pytest.mark.parametrize(("selection", "expected"), [("uniform", [0.5, 0, 0.5]), ("power", [0.75, 0, 0.25])])
def test_lights_without_power_are_never_chosen(selection: str, expected: list[float]) -> None:
    lights = [{"type": "point", "intensity": i} for i in (3, 0, 1)]
    _, result = compiled(scene_of(lights=lights, integrator={"light_selection": selection}))
    assert np.allclose(result.arrays["light_table"]["pmf"], expected, atol=1e-7)


def test_a_single_dark_light_is_still_asked() -> None:
    _, result = compiled(scene_of(lights=[{"type": "point", "intensity": 0}]))
    assert np.array_equal(result.arrays["light_table"]["pmf"], [1])


def test_emitters_without_an_area_are_no_lights() -> None:
    glow = {"emission": {"radiance": 1}}
    nothing = {"type": "sphere", "radius": 1e-25, **glow}
    geometry, lights = compiled(scene_of(shapes=[nothing, {"type": "quad", **glow}, nothing]))
    assert lights.light_count == 1
    assert np.array_equal(geometry.arrays["shapes"]["light"], [NONE, 0, NONE])


def test_no_lights_at_all() -> None:
    _, result = compiled(scene_of(shapes=SHAPES[:1]))
    assert result.light_count == 0
    assert result.environment_light == NONE
    assert len(result.arrays["lights"]) == 0


def test_scene_radius_covers_everything() -> None:
    for shapes, least, most in [
        (SHAPES, 4.0, 8.0),
        (SHAPES[:1], 0.5, 1.0),
        (SHAPES[4:], 0.9, 1.5),
        ([{**SHAPES[0], "transform": [{"scale": [8, 1, 1]}]}], 4.0, 4.5),
        ([{"type": "plane"}], 1.0, 1.0),
    ]:
        geometry, _ = compiled(scene_of(shapes=shapes))
        assert least <= scene_radius(geometry) <= most


def test_every_copy_of_an_emitting_prototype_is_a_light() -> None:
    lamp = {"type": "instance", "prototype": "lamp"}
    scene = scene_of(
        prototypes={"lamp": [{**SHAPES[1]}, {**SHAPES[0]}]},
        shapes=[{**lamp, "transform": [{"translate": [x, 0, 0]}]} for x in (0, 10, 20)],
    )
    geometry, lights = compiled(scene)
    assert lights.light_count == 3
    assert "many_lights" in analyse(scene)
    assert np.allclose(np.sort(lights.arrays["lights"]["position"][:, 0]), [-1, 9, 19])
    emitting = geometry.arrays["shapes"]["light"]
    assert sorted(emitting[emitting != NONE].tolist()) == [0, 1, 2]


def test_moving_lights_without_a_body_get_their_own_keyframes() -> None:
    steps = [[], [{"translate": [1, 0, 0]}]]
    move = {"keyframes": [{"time": i, "transform": step} for i, step in enumerate(steps)]}
    scene = scene_of(
        camera={"type": "perspective", "shutter": {"open": 0, "close": 1}},
        shapes=[{**SHAPES[0], "transform": move}],
        lights=[{**LIGHTS[2]}, {**LIGHTS[0], "transform": move}, {**LIGHTS[1], "transform": move}],
    )
    geometry, lights = compiled(scene, anchor=(1.0, 2.0, 3.0))
    keyframes = np.concatenate([geometry.keyframes, lights.keyframes])
    first, count = lights.arrays["lights"]["first_keyframe"], lights.arrays["lights"]["keyframe_count"]
    assert np.array_equal(count, [0, 2, 2])
    assert np.array_equal(first[1:] - len(geometry.keyframes), [0, 2])
    assert np.allclose(keyframes["translation"][first[1]], [-1, -2, -3])
    assert np.allclose(lights.arrays["lights"]["position"][1], [0, 4, 0])


TRACE = """
#include "geometry/intersect.cl"
#include "geometry/surface.cl"
#include "lights/lights.cl"
__kernel void aim_at(__global float *out, const __global float *p, const __global float *u, const float time,
    const uint root, const uint light_count, const __global TreeNode *nodes, const __global TreeTriangles *packets,
    const __global ShapeData *shapes, const __global TriangleData *triangles, const __global float *positions,
    const __global float *normals, const __global float *uvs, const __global SphereData *spheres,
    const __global DiscData *discs, const __global PlaneData *planes, const __global Instance *instances,
    const __global Keyframe *keyframes, const __global float *times, const __global Light *lights,
    const __global float *emitter_cdf) {
  const size_t i = get_global_id(0);
  SceneData s;
  s.nodes = nodes; s.packets = packets; s.shapes = shapes; s.triangles = triangles; s.positions = positions;
  s.normals = normals; s.uvs = uvs; s.spheres = spheres; s.discs = discs; s.planes = planes;
  s.instances = instances;
  s.keyframes = keyframes; s.times = times; s.lights = lights; s.emitter_cdf = emitter_cdf;
  s.root = root; s.light_count = light_count; s.environment_light = NONE; s.plane_count = 0u;
  const uint light = (uint)(i % light_count);
  __global float *o = out + 6 * i;
  for (int k = 0; k < 6; ++k) o[k] = 0.0f;
  const float3 from = load3(p + 3 * i);
  Receiver receiver;
  receiver.p = from;
  receiver.n = (float3)(0.0f);
  LightSample sample;
  if (!light_sample(&s, light, &receiver, time, u[3 * i + 2], (float2)(u[3 * i], u[3 * i + 1]), &sample)) return;
  Surface eye;
  eye.p = from; eye.p_error = (float3)(0.0f); eye.ng = sample.wi;
  o[0] = 1.0f;
  o[1] = occluded(&s, spawn_ray_to(&eye, sample.p, sample.p_error, sample.n, time)) ? 1.0f : 0.0f;
  Ray ray = spawn_ray(&eye, sample.wi, time);
  Hit hit;
  o[2] = sample.pdf;
  if (!intersect(&s, ray, &hit)) return;
  Surface surface;
  surface_at(&s, ray, hit, &surface);
  o[3] = (float)(s.shapes[surface.shape].light + 1u);
  o[4] = light_hit_pdf(&s, light, from, &surface, sample.wi, hit.t, time);
  o[5] = light_emitted(&s, &surface, -sample.wi).x;
}
"""

BUFFERS = (
    *("nodes", "packets", "shapes", "triangles", "positions", "normals", "uvs", "spheres", "discs", "planes"),
    *("instances", "keyframes", "times", "lights", "emitter_cdf"),
)
"""In the order of the kernel's arguments."""
EFFECTS = "AREA_LIGHTS DELTA_LIGHTS MANY_LIGHTS LIGHT_TREE ENVIRONMENT ENVIRONMENT_IMAGE MOTION INSTANCING ROUND DEFORMATION"
FLAGS = {f"PENUMBRA_{name}": 1 for name in EFFECTS.split(" ")}

MIRROR = [{"scale": [-1, 1, 1]}]


def placed(transform, offset=(0, 0, 0)):
    """The four kinds of area light in one scene, apart from one another, under one transform each."""
    shapes = []
    for shape in SHAPES[1:]:
        moved = transform if isinstance(transform, dict) else [*transform, {"translate": list(offset)}]
        shapes.append({**shape, "transform": moved})
    return scene_of(camera={"type": "perspective", "shutter": {"open": 0, "close": 1}}, shapes=shapes)


CASES = {
    "plain": (placed([]), (0, 0, 0)),
    "mirrored": (placed(MIRROR), (0, 0, 0)),
    "stretched": (placed(STRETCH), (0, 0, 0)),
    "moving": (placed(MOVE), (0, 0, 0)),
    "far from the anchor": (placed([], FAR), np.subtract(FAR, [100, 200, -300])),
    "stretched, far": (placed(STRETCH, FAR), np.subtract(FAR, [100, 200, -300])),
}


@pytest.fixture(scope="module", params=[0, 1], ids=["solid angle", "area"])
def aim(request, device):
    program = device.build("aim.cl", {**FLAGS, "PENUMBRA_LIGHT_AREA_SAMPLING": request.param}, TRACE)
    kernel = program.aim_at

    def run(scene: Scene, anchor, points: np.ndarray, u: np.ndarray, time: float) -> np.ndarray:
        geometry, lights = compiled(scene, anchor)
        every = {**geometry.arrays, **lights.arrays, "keyframes": geometry.keyframes}
        arrays = tree_arrays(every, device.flags)
        buffers = [device.upload(arrays[name]) for name in BUFFERS]
        out = np.empty((len(points), 6), np.float32)
        target = device.allocate(out.nbytes)
        numbers = [device.upload(np.asarray(a, np.float32)) for a in (points, u)]
        scalars = np.float32(time), np.uint32(geometry.root), np.uint32(lights.light_count)
        kernel(device.queue, (len(points),), None, target, *numbers, *scalars, *buffers)
        device.download(target, out)
        return out

    return run


@pytest.mark.parametrize("name", CASES)
def test_shadow_rays_stop_short_of_their_light_and_lobe_rays_find_it(aim, name: str) -> None:
    """With nothing but lights in the scene: no light shadows itself; the ray along a sample's direction meets
    that light (or one in front), and the density told for the hit is the sample's."""
    scene, anchor = CASES[name]
    count = 40_000
    rng = np.random.default_rng(61)
    middle = np.array([0, 2, 0]) + (np.array(FAR) - anchor if "far" in name else 0)
    points = rng.normal(0, 4, (count, 3)) + middle
    u = (rng.integers(0, 1 << 24, (count, 3)) * 2.0**-24).astype(np.float32)
    out = aim(scene, anchor, points, u, 0.6)
    light = np.arange(count) % 4 + 1
    given = out[:, 0] == 1
    assert np.bincount(light[given], minlength=5)[1:].min() > 1000
    own = given & (out[:, 3] == light)
    others = given & (out[:, 3] != light) & (out[:, 3] > 0)
    # A shadow ray may be stopped by another light, never by its own.
    blocked = given & (out[:, 1] == 1)
    assert not np.any(blocked & own)
    missed = given & (out[:, 3] == 0)
    assert missed.sum() <= 2e-3 * given.sum()  # grazing a rim by less than rounding
    assert own.sum() > 0.8 * given.sum()
    assert others.sum() < 0.2 * given.sum()
    wide = own & (out[:, 4] > 0)
    assert wide.sum() >= 0.995 * own.sum()
    relative = np.abs(out[wide, 4] / out[wide, 2] - 1)
    # coordinates of 374 m hold 3e-5 m: a hit near a small sphere's rim has a cosine of so many digits
    assert np.quantile(relative, 0.99) < (2e-2 if "far" in name else 2e-3)
    assert np.median(relative) < 1e-4
    assert np.all(out[wide, 5] == 2.0)
