"""Lights in sixteen lanes: each lane that is on has the bits of the scalar functions, whatever the others hold."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.compile.alias import alias_table
from penumbra_kernels.compile.light_bounds import LightBounds
from penumbra_kernels.compile.light_tree import build_light_tree
from penumbra_kernels.hardcases.benches.lights import EVERYTHING, SCENE_ARGUMENTS, LightBench
from penumbra_kernels.layout import INSTANCE, LIGHT, SHAPE, TRIANGLE

GROUPS = 64
COUNT = 16 * GROUPS
NOTHING = dict.fromkeys(EVERYTHING, 0)

# Each kernel computes one thing in lanes and, lane by lane, with the scalar function: out holds a row of the one, then a row of
# the other, for every lane; zeros where it is off.
TEXT = """
#include "lights/lights16.cl"
static Vec16 load3_16(const __global float *from) {
  Vec16 v;
  for (uint k = 0u; k < LANES; k++) set_lane3(&v, k, load3(from + 3u * k));
  return v;
}
static float16 load16(const __global float *from) { return *(const __global float16 *)from; }
static Mask16 mask_of(const uint bits) {
  Mask16 on;
  for (uint k = 0u; k < LANES; k++) LANE_I(on, k) = bits >> k & 1u ? -1 : 0;
  return on;
}
static __global float *clear(__global float *out, const uint width) {
  __global float *rows = out + get_global_id(0) * LANES * width;
  for (uint k = 0u; k < LANES * width; k++) rows[k] = 0.0f;
  return rows;
}
static void put3(__global float *o, const float3 v) { o[0] = v.x; o[1] = v.y; o[2] = v.z; }
#define BEGIN(WIDTH) \\
  const uint first = (uint)get_global_id(0) * LANES; \\
  const SceneData scene = SCENE; \\
  const Mask16 on = mask_of(lanes[get_global_id(0)]); \\
  __global float *rows = clear(out, 2u * WIDTH)

__kernel void sample16(__global float *out, const __global float *p, const __global float *n, const __global float *ux,
                       const __global float *uy, const __global float *ut, const __global float *time,
                       const __global uint *light, const __global uint *lanes, ARGUMENTS) {
  BEGIN(20u);
  const Lights16 lit_by = lights16(&scene, *(const __global uint16 *)(light + first), on);
  Receiver16 receiver;
  receiver.p = load3_16(p + 3u * first);
  receiver.n = load3_16(n + 3u * first);
  LightSample16 s;
  const Mask16 given = light_sample16(&scene, &lit_by, &receiver, load16(time + first), load16(ut + first),
                                      load16(ux + first), load16(uy + first), on, &s);
  const Mask16 delta = ~lights_have_extent16(&lit_by, on);
  for (LANES_OF(k, on)) {
    __global float *o = rows + 40u * k;
    if (LANE_I(given, k)) {
      o[0] = 1.0f; o[1] = LANE_I(delta, k) != 0; o[2] = LANE_F(s.distance, k); o[3] = LANE_F(s.pdf, k);
      put3(o + 4, lane3(&s.wi, k)); put3(o + 7, lane3(&s.radiance, k)); put3(o + 10, lane3(&s.p, k));
      if (LANE_F(s.distance, k) < INF_F) { put3(o + 13, lane3(&s.p_error, k)); put3(o + 16, lane3(&s.n, k)); }
    }
    LightSample one;
    const Receiver lit = lane_receiver(&receiver, k);
    const uint i = first + k;
    o += 20u;
    if (!light_sample(&scene, light[i], &lit, time[i], ut[i], (float2)(ux[i], uy[i]), &one)) continue;
    o[0] = 1.0f; o[1] = one.delta; o[2] = one.distance; o[3] = one.pdf;
    put3(o + 4, one.wi); put3(o + 7, one.radiance); put3(o + 10, one.p);
    if (one.distance < INF_F) { put3(o + 13, one.p_error); put3(o + 16, one.n); }
  }
  const Mask16 more = given & ~on;
  for (LANES_OF(k, more)) rows[40u * k] = 1.0f;
}

__kernel void hit16(__global float *out, const __global float *p, const __global float *wi, const __global float *ng,
                    const __global float *distance, const __global uint *primitive, const __global float *time,
                    const __global uint *light, const __global uint *lanes, ARGUMENTS) {
  BEGIN(4u);
  const Lights16 met = lights16(&scene, *(const __global uint16 *)(light + first), on);
  const Vec16 normal = load3_16(ng + 3u * first), direction = load3_16(wi + 3u * first);
  const uint16 primitives = *(const __global uint16 *)(primitive + first);
  const float16 pdf = light_hit_pdf16(&scene, &met, load3_16(p + 3u * first), normal, primitives, direction,
                                      load16(distance + first), load16(time + first), on);
  const Vec16 radiance = light_emitted16(&met, normal, direction, on);
  for (LANES_OF(k, on)) {
    const uint i = first + k;
    Surface hit;
    hit.ng = load3(ng + 3u * i);
    hit.primitive = primitive[i];
    hit.shape = light[i];
    rows[8u * k] = LANE_F(pdf, k);
    put3(rows + 8u * k + 1u, lane3(&radiance, k));
    rows[8u * k + 4u] = light_hit_pdf(&scene, light[i], load3(p + 3u * i), &hit, load3(wi + 3u * i), distance[i], time[i]);
    put3(rows + 8u * k + 5u, light_emitted(&scene, &hit, load3(wi + 3u * i)));
  }
}

__kernel void choose16(__global float *out, const __global float *u, const __global float *u2, const __global float *p,
                       const __global float *n, const __global uint *asked, const __global uint *lanes, ARGUMENTS) {
  BEGIN(6u);
  Receiver16 receiver;
  receiver.p = load3_16(p + 3u * first);
  receiver.n = load3_16(n + 3u * first);
  Point16 point;
  point.x = load16(u + first);
  point.y = load16(u2 + first);
  float16 pmf;
  const uint16 light = light_choose16(&scene, &receiver, on, &point, &pmf);
  const float16 again = light_pmf16(&scene, &receiver, light, on);
  const float16 other = light_pmf16(&scene, &receiver, *(const __global uint16 *)(asked + first), on);
  for (LANES_OF(k, on)) {
    const Receiver lit = lane_receiver(&receiver, k);
    float2 rest = (float2)(u[first + k], u2[first + k]);
    float chance;
    const uint one = light_choose(&scene, &lit, &rest, &chance);
    put3(rows + 12u * k, (float3)((float)LANE_U(light, k), LANE_F(pmf, k), LANE_F(again, k)));
    put3(rows + 12u * k + 3u, (float3)(LANE_F(other, k), LANE_F(point.x, k), LANE_F(point.y, k)));
    put3(rows + 12u * k + 6u, (float3)((float)one, chance, light_pmf(&scene, &lit, one)));
    put3(rows + 12u * k + 9u, (float3)(light_pmf(&scene, &lit, asked[first + k]), rest.x, rest.y));
  }
}

#if PENUMBRA_ENVIRONMENT
__kernel void sky16(__global float *out, const __global float *d, const __global float *n, const __global uint *lanes,
                    ARGUMENTS) {
  BEGIN(4u);
  const Vec16 directions = load3_16(d + 3u * first);
  const Vec16 radiance = environment_radiance16(&scene, directions, on);
  const float16 pdf = environment_pdf16(&scene, load3_16(n + 3u * first), directions, on);
  for (LANES_OF(k, on)) {
    const uint i = first + k;
    put3(rows + 8u * k, lane3(&radiance, k));
    rows[8u * k + 3u] = LANE_F(pdf, k);
    put3(rows + 8u * k + 4u, environment_radiance(&scene, load3(d + 3u * i)));
    rows[8u * k + 7u] = environment_pdf(&scene, load3(n + 3u * i), load3(d + 3u * i));
  }
}
#endif
""".replace("ARGUMENTS", SCENE_ARGUMENTS)


class Lanes(LightBench):
    """Runs both ways of everything on COUNT lanes, some of them off and full of NaN."""

    text = LightBench.text + TEXT

    def both(self, kernel, scene, width, inputs, seed):
        """(lanes, scalars), (lanes on, width) each, as bits."""
        rng = np.random.default_rng(seed)
        on = rng.random((GROUPS, 16)) < rng.choice([0.1, 0.5, 0.9, 1.0], GROUPS)[:, None]
        bits = (on << np.arange(16)).sum(axis=1).astype(np.uint32)
        given = [np.array(np.broadcast_to(a, (COUNT, *a.shape[1:]))) for a in inputs]
        for a in given:
            a[~on.ravel()] = np.nan if a.dtype == np.float32 else 0
        out = np.empty((COUNT, 2 * width), np.float32)
        self._run(kernel, out, GROUPS, scene, *given, bits)
        assert not np.any(out[~on.ravel()])
        kept = out[on.ravel()]
        assert not np.isnan(kept).any()
        return kept[:, :width].view(np.uint32), kept[:, width:].view(np.uint32)


def uniform(seed):
    return LightBench.uniform(COUNT, seed, 1)[:, 0]


def directions(seed):
    d = np.random.default_rng(seed).normal(size=(COUNT, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def receivers(size, seed):
    """Points about a light of some size at the origin, in the plane z = 0: near, far, behind, grazing, in the plane, on it."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-3, 3, (COUNT, 3)) * size * 10.0 ** rng.choice([-1, 0, 0, 1, 4], (COUNT, 1))
    p[:, 2] *= rng.choice([1, 1, 1, 1e-2, 1e-4, 1e-6, 0], COUNT)
    p[rng.random(COUNT) < 0.02] = 0.0
    return p.astype(np.float32)


def scene_of(bench, *records, **more):
    shapes = np.zeros(len(records), SHAPE)
    shapes["light"] = np.arange(len(records))
    return bench.scene(list(records), shapes=shapes, **more)


def agree(bench, scene, p, seed, index=0, size=1.0):
    """Samples for receivers at p, densities and radiance of directions from there: of one light, or of some in turns."""
    normals = np.where(uniform(seed)[:, None] < 0.2, np.float32(0.0), directions(seed + 1))
    numbers = [uniform(seed + k) for k in range(2, 5)]
    time = uniform(seed + 5)
    light = np.resize(np.asarray(index, np.uint32), COUNT)
    lanes, scalars = bench.both("sample16", scene, 20, [p, normals, *numbers, time, light], seed)
    assert np.array_equal(lanes, scalars)
    distance = (np.float32(size) * (0.01 + uniform(seed + 6))).astype(np.float32)
    inputs = [
        p,
        directions(seed + 7),
        directions(seed + 8),
        distance,
        np.zeros(COUNT, np.uint32),
        time,
        light,
    ]
    again, hits = bench.both("hit16", scene, 4, inputs, seed + 9)
    assert np.array_equal(again, hits)
    return scalars.view(np.float32), hits.view(np.float32)


def choose_alike(bench, scene, p, seed):
    """(light, pmf, pmf again, pmf of any light, what is left of the point) for receivers at p, of lanes that are on."""
    normals = np.where(uniform(seed)[:, None] < 0.2, np.float32(0.0), directions(seed + 1))
    asked = np.random.default_rng(seed + 2).integers(0, len(scene.lights), COUNT).astype(np.uint32)
    lanes, scalars = bench.both(
        "choose16", scene, 6, [uniform(seed + 3), uniform(seed + 5), p, normals, asked], seed + 4
    )
    assert np.array_equal(lanes, scalars)
    chosen = scalars.view(np.float32)
    assert np.array_equal(chosen[:, 1], chosen[:, 2])
    return chosen


def quad(bench, size=1.0, u=(1.0, 0.0, 0.0), v=(0.0, 0.7, 0.0), **more):
    edges = [np.array(e, np.float32) * np.float32(size) for e in (u, v)]
    return bench.light(
        "quad", position=-0.5 * (edges[0] + edges[1]), direction=edges[0], axis_v=edges[1], **more
    )


QUADS = {
    "rectangle": {},
    "two-sided": {"flags": 1},
    "tiny": {"size": 1e-4, "flags": 1},
    "huge": {"size": 1e5, "flags": 1},
    "strip": {"v": (0.0, 1e-3, 0.0), "flags": 1},
    "parallelogram": {"v": (0.4, 0.7, 0.0), "flags": 1},
    "no area": {"v": (2.0, 0.0, 0.0)},
}


@pytest.fixture(scope="module", params=["default", "portable", "area"])
def any_lanes(request, device):
    """Everything in; without builtins, and no light carried; sampling by area."""
    portable = {"PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0, "PENUMBRA_INSTANCING": 0}
    flags = {"default": {}, "portable": portable, "area": {"PENUMBRA_LIGHT_AREA_SAMPLING": 1}}
    return Lanes(device, flags[request.param])


@pytest.mark.parametrize("name", QUADS)
def test_quads(any_lanes, name):
    size = QUADS[name].get("size", 1.0)
    scene = scene_of(any_lanes, quad(any_lanes, **QUADS[name]))
    samples, hits = agree(any_lanes, scene, receivers(size, 100), 110, size=size)
    if name != "no area":
        assert 0.2 < np.mean(samples[:, 0]) < 0.99
        assert np.mean(hits[:, 0] > 0) > 0.2


def test_quads_from_points_in_their_plane_to_rounding(any_lanes):
    record = quad(any_lanes, flags=1)
    record["position"][2] = 0.49
    p = receivers(1.0, 150)
    p[:, 2] = np.float32(0.49) + np.random.default_rng(151).integers(-20, 21, COUNT) * 2.0**-25
    samples, _ = agree(any_lanes, scene_of(any_lanes, record), p, 160)
    assert 0.3 < np.mean(samples[:, 0]) < 0.7


@pytest.mark.parametrize("flags", [0, 1])
@pytest.mark.parametrize("radius", [1e-4, 1.0, 1e5])
def test_spheres(any_lanes, radius, flags):
    record = any_lanes.light("sphere", position=(0, 0, radius), inner=radius, flags=flags)
    samples, _ = agree(any_lanes, scene_of(any_lanes, record), receivers(radius, 200), 210, size=radius)
    assert np.mean(samples[:, 0]) > 0.05


def test_environments(any_lanes):
    record = any_lanes.light("environment", position=(1, 0, 0), direction=(0, 1, 0), axis_v=(0, 0, 1))
    scene = scene_of(any_lanes, record, environment_light=0)
    samples, _ = agree(any_lanes, scene, receivers(1.0, 300), 310)
    assert np.all(samples[:, 0] == 1)
    for normal in (directions(320), np.zeros((1, 3), np.float32)):
        lanes, scalars = any_lanes.both("sky16", scene, 4, [directions(321), normal], 322)
        assert np.array_equal(lanes, scalars)
        assert np.any(scalars[:, 3])


def test_an_environments_image(any_lanes):
    width, height = 8, 4
    rng = np.random.default_rng(400)
    cdf = np.concatenate([np.linspace(0, 1, height + 1), np.tile(np.linspace(0, 1, width + 1), height)])
    texels = rng.random((width * height, 4)).astype(np.float32)
    tail = np.resize(cdf, (len(cdf) + 3) // 4 * 4).astype(np.float32).reshape(-1, 4)
    axes = {"position": (1, 0, 0), "direction": (0, 1, 0), "axis_v": (0, 0, 1)}
    record = any_lanes.light("environment", width=width, height=height, first_cdf=4 * len(texels), **axes)
    scene = scene_of(any_lanes, record, environment=np.concatenate([texels, tail]), environment_light=0)
    samples, _ = agree(any_lanes, scene, receivers(1.0, 410), 420)
    assert np.mean(samples[:, 0]) > 0.9
    lanes, scalars = any_lanes.both("sky16", scene, 4, [directions(430), directions(431)], 432)
    assert np.array_equal(lanes, scalars)


def test_lights_that_are_taken_lane_by_lane(any_lanes):
    axis = {"direction": (0, 0, -1), "axis_v": (0, 1, 0)}
    instances = np.zeros(1, INSTANCE)
    for name in ("object_from_world", "world_from_object"):
        instances[name] = np.eye(3, 4).reshape(instances[name].shape[1:])
    triangles = np.zeros(1, TRIANGLE)
    triangles["vertex"] = [0, 1, 2]
    records = [
        any_lanes.light("disc", inner=1.0, outer=1.0, **axis),
        any_lanes.light("mesh", shape=1, triangle_count=1, flags=1),
        any_lanes.light("point", position=(0, 0, 1)),
        any_lanes.light("spot", position=(0, 0, 1), inner=0.9, outer=0.1, **axis),
        any_lanes.light("directional", **axis),
        quad(any_lanes, instance=0),
        any_lanes.light("sphere", position=(0, 0, 2), inner=1.0, instance=0),
    ]
    scene = scene_of(
        any_lanes,
        *records,
        instances=instances,
        emitter_cdf=np.array([0, 1], np.float32),
        triangles=triangles,
        positions=np.array([[0, 1, 0], [1, 1.5, 0], [0, 1, 1]], np.float32),
        light_table=alias_table(np.arange(1.0, 8.0)),
    )
    p = receivers(1.0, 500)
    for index in range(len(records)):
        samples, _ = agree(any_lanes, scene, p, 510 + 10 * index, index)
        assert np.any(samples[:, 0])
    agree(any_lanes, scene, p, 590, np.random.default_rng(591).integers(0, len(records), COUNT))
    assert len(np.unique(choose_alike(any_lanes, scene, p, 600)[:, 0])) == len(records)


def test_every_lane_with_a_light_of_its_own(any_lanes):
    instances = np.zeros(1, INSTANCE)
    for name in ("object_from_world", "world_from_object"):
        instances[name] = np.eye(3, 4).reshape(instances[name].shape[1:])
    records = [quad(any_lanes, **{k: v for k, v in q.items() if k != "size"}) for q in QUADS.values()]
    for k, record in enumerate(records):
        record["radiance"] = k + 1.0
    records += [
        any_lanes.light("sphere", position=(0, 0, 2), inner=1.0, radiance=20.0),
        any_lanes.light("sphere", position=(0, 0.5, -1), inner=0.1, radiance=30.0, flags=1),
        quad(any_lanes, instance=0, radiance=40.0),
        any_lanes.light("disc", direction=(0, 0, 1), axis_v=(0, 1, 0), inner=1.0, outer=1.0),
        any_lanes.light("point", position=(0, 0, 1)),
        any_lanes.light("environment", position=(1, 0, 0), direction=(0, 1, 0), axis_v=(0, 0, 1)),
    ]
    scene = scene_of(any_lanes, *records, instances=instances, environment_light=len(records) - 1)
    rng = np.random.default_rng(650)
    for count in (len(records), len(QUADS) + 2, len(QUADS)):  # of all kinds; quads and spheres; quads
        samples, hits = agree(any_lanes, scene, receivers(1.0, 660), 670, rng.integers(0, count, COUNT))
        assert len(np.unique(samples[:, 7])) > count - 4
        assert np.mean(hits[:, 0] > 0) > 0.2


def light_bounds(count, rng):
    """Lamps of very different power in a room; some far away, some without power."""
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return [
        LightBounds(
            rng.uniform(-2, 2, 3) if k % 7 else axes[k],
            float(rng.uniform(0, 0.5)) if k % 7 else -1.0,
            axes[k] if k % 3 else np.zeros(3),
            float(rng.uniform(0, 0.3)) if k % 3 else np.pi,
            float(rng.uniform(0.2, np.pi / 2)),
            float(10 ** rng.uniform(-3, 3)) if k % 5 != 4 else 0.0,
        )
        for k in range(count)
    ]


@pytest.mark.parametrize("count", [1, 6, 40, 2000])
def test_light_trees(any_lanes, count):
    tree = build_light_tree(light_bounds(count, np.random.default_rng(count)))
    records = [any_lanes.light("point") for _ in range(count)]
    for record, leaf in zip(records, tree.leaf, strict=True):
        record["leaf"] = leaf
    scene = any_lanes.scene(records, light_nodes=tree.nodes)
    chosen = choose_alike(any_lanes, scene, receivers(1.0, 800), 810)
    assert len(np.unique(chosen[:, 0])) > min(count // 2, 100)
    assert np.any(chosen[:, 3] == 0) or count == 1
    assert np.any(chosen[:, 3] > 0)


@pytest.mark.parametrize("count", [2, 300_000])
def test_alias_tables(any_lanes, count):
    weights = np.random.default_rng(count).lognormal(0, 3, count)
    scene = any_lanes.scene(np.zeros(count, LIGHT), light_table=alias_table(weights))
    chosen = choose_alike(any_lanes, scene, receivers(1.0, 900), 910)
    assert len(np.unique(chosen[:, 0])) > min(count - 1, 100)


@pytest.mark.parametrize("flag", ["AREA_LIGHTS", "DELTA_LIGHTS", "ENVIRONMENT", None])
def test_programs_with_one_kind_or_none(device, flag):
    special = Lanes(device, {**NOTHING, **({f"PENUMBRA_{flag}": 1} if flag else {})})
    kind = {"AREA_LIGHTS": "disc", "DELTA_LIGHTS": "point"}.get(flag, "environment")
    record = special.light(
        kind, position=(0, 0, 1), direction=(0, 0, 1), axis_v=(0, 1, 0), inner=1.0, outer=1.0
    )
    scene = scene_of(special, record, **({"environment_light": 0} if kind == "environment" else {}))
    p = receivers(1.0, 700)
    samples, _ = agree(special, scene, p, 710)
    assert np.any(samples[:, 0]) == (flag is not None)
    assert np.all(choose_alike(special, scene, p, 720)[:, :3] == [0, 1, 1])
