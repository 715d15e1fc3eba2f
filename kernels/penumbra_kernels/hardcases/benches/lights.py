"""A bench for cl/lights: scenes of hand-written light records, sampled on a device.

Positions in metres, world frame; densities per solid angle at the lit point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from penumbra_kernels.compile.alias import STEPS, quantised_cdf
from penumbra_kernels.device import Device
from penumbra_kernels.layout import ALIAS, CONSTANTS, INSTANCE, KEYFRAME, LIGHT, LIGHT_NODE, SHAPE, TRIANGLE

Array = NDArray[Any]
NONE = CONSTANTS["NONE"]
ORIGIN = np.zeros(3, np.float32)

EVERYTHING = {
    "PENUMBRA_AREA_LIGHTS": 1,
    "PENUMBRA_DELTA_LIGHTS": 1,
    "PENUMBRA_MANY_LIGHTS": 1,
    "PENUMBRA_LIGHT_TREE": 1,
    "PENUMBRA_ENVIRONMENT": 1,
    "PENUMBRA_ENVIRONMENT_IMAGE": 1,
    "PENUMBRA_MOTION": 1,
    "PENUMBRA_INSTANCING": 1,
    "PENUMBRA_LIGHT_AREA_SAMPLING": 0,
}

SCENE_ARGUMENTS = (
    "const __global Light *lights, const __global Alias *light_table, const __global float *emitter_cdf, "
    "const __global float4 *environment, const __global Instance *instances, "
    "const __global Keyframe *keyframes, const __global ShapeData *shapes, "
    "const __global TriangleData *triangles, const __global float *positions, "
    "const __global LightNode *light_nodes, const uint light_tree, "
    "const uint light_count, const uint environment_light"
)

TEXT = """
#include "lights/lights.cl"
static inline SceneData scene_of(ARGUMENTS) {
  SceneData s;
  s.lights = lights; s.light_table = light_table; s.emitter_cdf = emitter_cdf; s.environment = environment;
  s.instances = instances; s.keyframes = keyframes; s.shapes = shapes; s.triangles = triangles;
  s.positions = positions; s.light_nodes = light_nodes; s.light_tree = light_tree != 0u;
  s.light_count = light_count; s.environment_light = environment_light;
  return s;
}
#define SCENE scene_of(lights, light_table, emitter_cdf, environment, instances, keyframes, shapes, \\
                       triangles, positions, light_nodes, light_tree, light_count, environment_light)
__kernel void sample(__global float *out, const __global float *p, const __global float *n, const __global float *u,
                     const uint light, const float time, ARGUMENTS) {
  const size_t i = get_global_id(0);
  const SceneData scene = SCENE;
  LightSample s;
  const float2 u2 = (float2)(u[3 * i], u[3 * i + 1]);
  Receiver receiver;
  receiver.p = load3(p + 3 * i);
  receiver.n = load3(n + 3 * i);
  const bool ok = light_sample(&scene, light, &receiver, time, u[3 * i + 2], u2, &s);
  __global float *o = out + 20 * i;
  for (int k = 0; k < 20; ++k) o[k] = 0.0f;
  if (!ok) return;
  o[0] = s.wi.x; o[1] = s.wi.y; o[2] = s.wi.z; o[3] = s.distance;
  o[4] = s.radiance.x; o[5] = s.radiance.y; o[6] = s.radiance.z; o[7] = s.pdf;
  o[8] = s.p.x; o[9] = s.p.y; o[10] = s.p.z; o[11] = s.delta ? 2.0f : 1.0f;
  o[12] = s.n.x; o[13] = s.n.y; o[14] = s.n.z; o[15] = s.p_error.x; o[16] = s.p_error.y; o[17] = s.p_error.z;
}
__kernel void hit_pdf(__global float *out, const __global float *p, const __global float *wi,
                      const __global float *ng, const __global float *distance,
                      const __global uint *primitive, const uint light, const float time, ARGUMENTS) {
  const size_t i = get_global_id(0);
  const SceneData scene = SCENE;
  Surface hit;
  hit.ng = load3(ng + 3 * i);
  hit.primitive = primitive[i];
  out[i] = light_hit_pdf(&scene, light, load3(p + 3 * i), &hit, load3(wi + 3 * i), distance[i], time);
}
__kernel void emitted(__global float *out, const __global float *wo, const __global float *ng,
                      const uint shape, ARGUMENTS) {
  const size_t i = get_global_id(0);
  const SceneData scene = SCENE;
  Surface hit;
  hit.ng = load3(ng + 3 * i);
  hit.shape = shape;
  hit.instance = NONE;
  const float3 radiance = light_emitted(&scene, &hit, load3(wo + 3 * i));
  for (int k = 0; k < 3; ++k) out[3 * i + k] = k == 0 ? radiance.x : (k == 1 ? radiance.y : radiance.z);
}
__kernel void choose(__global float *out, const __global float *u, const __global float *p, const __global float *n,
                     ARGUMENTS) {
  const size_t i = get_global_id(0);
  const SceneData scene = SCENE;
  Receiver receiver;
  receiver.p = load3(p + 3 * i);
  receiver.n = load3(n + 3 * i);
  float2 point = (float2)(u[2 * i], u[2 * i + 1]);
  float pmf;
  const uint light = light_choose(&scene, &receiver, &point, &pmf);
  out[5 * i] = (float)light;
  out[5 * i + 1] = pmf;
  out[5 * i + 2] = light_pmf(&scene, &receiver, light);
  out[5 * i + 3] = point.x;
  out[5 * i + 4] = point.y;
}
__kernel void pmf(__global float *out, const __global uint *light, const __global float *p, const __global float *n,
                  ARGUMENTS) {
  const size_t i = get_global_id(0);
  const SceneData scene = SCENE;
  Receiver receiver;
  receiver.p = load3(p + 3 * i);
  receiver.n = load3(n + 3 * i);
  out[i] = light_pmf(&scene, &receiver, light[i]);
}
// One receiver, `block` uniform numbers a work-item: how many lead to each of light_count lights, last those for which the
// pmf is not the one told.
__kernel void tally(__global uint *out, const __global float *at, const __global float *told, const uint block,
                    ARGUMENTS) {
  const SceneData scene = SCENE;
  const uint entries = light_entries(&scene), first = (uint)get_global_id(0) * block;
  __global uint *row = out + get_global_id(0) * (entries + 1u);
  Receiver receiver;
  receiver.p = load3(at);
  receiver.n = load3(at + 3);
  for (uint k = 0; k <= entries; ++k) row[k] = 0u;
  for (uint k = first; k < first + block; ++k) {
    float2 point = (float2)((float)k * 0x1p-24f, 0.0f);
    float pmf;
    const uint light = light_choose(&scene, &receiver, &point, &pmf);
    row[pmf == told[light] ? light : entries]++;
  }
}
__kernel void sky(__global float *out, const __global float *d, const __global float *n, ARGUMENTS) {
  const size_t i = get_global_id(0);
  const SceneData scene = SCENE;
  const float3 wi = load3(d + 3 * i);
  const float3 radiance = environment_radiance(&scene, wi);
  out[4 * i] = radiance.x; out[4 * i + 1] = radiance.y; out[4 * i + 2] = radiance.z;
  out[4 * i + 3] = environment_pdf(&scene, load3(n + 3 * i), wi);
}
""".replace("ARGUMENTS", SCENE_ARGUMENTS)


def light(kind: str, **values: Any) -> Array:
    """One LIGHT record in the world frame; white radiance 1 unless told."""
    record = np.zeros((), LIGHT)
    record["type"] = CONSTANTS[f"LIGHT_{kind.upper()}"]
    record["instance"] = NONE
    record["radiance"] = 1.0
    for key, value in values.items():
        record[key] = value
    return record


def rows(a: Array, count: int) -> Array:
    """(count, 3) float32 of points or of one point."""
    return np.ascontiguousarray(np.broadcast_to(np.asarray(a, np.float32), (count, 3)))


@dataclass
class LightScene:
    """Device arrays of a scene that has nothing but lights."""

    lights: list[Array]
    light_table: Array = field(default_factory=lambda: np.zeros(1, ALIAS))
    emitter_cdf: Array = field(default_factory=lambda: np.zeros(1, np.float32))
    environment: Array = field(default_factory=lambda: np.zeros((1, 4), np.float32))
    instances: Array = field(default_factory=lambda: np.zeros(1, INSTANCE))
    keyframes: Array = field(default_factory=lambda: np.zeros(1, KEYFRAME))
    shapes: Array = field(default_factory=lambda: np.zeros(1, SHAPE))
    triangles: Array = field(default_factory=lambda: np.zeros(1, TRIANGLE))
    positions: Array = field(default_factory=lambda: np.zeros((1, 3), np.float32))
    light_nodes: Array = field(default_factory=lambda: np.zeros(0, LIGHT_NODE))
    """Of the light tree, which chooses where there are any."""
    environment_light: int = NONE


@dataclass
class Samples:
    """Light samples; only those that the light gave."""

    index: Array
    wi: Array
    distance: Array
    radiance: Array
    pdf: Array
    p: Array
    n: Array
    p_error: Array
    delta: Array


class LightBench:
    """cl/lights built with some flags on a device, and what tests need to use it."""

    light = staticmethod(light)
    scene = LightScene
    NONE = NONE
    text = TEXT

    def __init__(self, device: Device, flags: Mapping[str, int] | None = None) -> None:
        self.device = device
        program = device.build("lights_test.cl", {**EVERYTHING, **(flags or {})}, self.text)
        self._kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}

    def _run(self, kernel: str, out: Array, count: int, scene: LightScene, *arguments: Any) -> None:
        buffers = [self.device.upload(a) if isinstance(a, np.ndarray) else a for a in arguments]
        names = (
            "light_table",
            "emitter_cdf",
            "environment",
            "instances",
            "keyframes",
            "shapes",
            "triangles",
            "positions",
            "light_nodes",
        )
        world = [self.device.upload(np.array(scene.lights, LIGHT))]
        world += [self.device.upload(getattr(scene, name)) for name in names]
        own = len(scene.lights) - (scene.environment_light != NONE)
        target = self.device.allocate(out.nbytes)
        tree = np.uint32(len(scene.light_nodes) > 0)
        counts = (tree, np.uint32(own), np.uint32(scene.environment_light))
        self._kernels[kernel](self.device.queue, (count,), None, target, *buffers, *world, *counts)
        self.device.download(target, out)

    def sample(
        self, scene: LightScene, p: Any, u: Array, index: int = 0, time: float = 0.0, n: Any = ORIGIN
    ) -> Samples:
        """Samples of a light at points p (n, 3) or one point, by the uniform numbers u (n, 2 or 3), for receivers of the
        normals n (n, 3) or one; 0 where light from any side counts."""
        count = len(u)
        points, normals = rows(p, count), rows(n, count)
        numbers = np.full((count, 3), 0.5, np.float32)
        numbers[:, : u.shape[1]] = u
        out = np.empty((count, 20), np.float32)
        self._run("sample", out, count, scene, points, normals, numbers, np.uint32(index), np.float32(time))
        kept = np.flatnonzero(out[:, 11])
        o = out[kept]
        return Samples(
            kept,
            o[:, 0:3],
            o[:, 3],
            o[:, 4:7],
            o[:, 7],
            o[:, 8:11],
            o[:, 12:15],
            o[:, 15:18],
            o[:, 11] == 2.0,
        )

    def hit_pdf(
        self,
        scene: LightScene,
        p: Array,
        wi: Array,
        distance: Array,
        ng: Array,
        primitive: Array | int = 0,
        index: int = 0,
        time: float = 0.0,
    ) -> Array:
        """Densities of directions that met the light."""
        count = len(wi)
        points = rows(p, count)
        out = np.empty(count, np.float32)
        primitives = np.ascontiguousarray(np.broadcast_to(np.asarray(primitive, np.uint32), (count,)))
        numbers = [np.asarray(a, np.float32) for a in (wi, ng, distance)]
        tail = (np.uint32(index), np.float32(time))
        self._run("hit_pdf", out, count, scene, points, *numbers, primitives, *tail)
        return out

    def emitted(self, scene: LightScene, wo: Array, ng: Array, shape: int = 0) -> Array:
        out = np.empty((len(wo), 3), np.float32)
        self._run(
            "emitted",
            out,
            len(wo),
            scene,
            np.asarray(wo, np.float32),
            np.asarray(ng, np.float32),
            np.uint32(shape),
        )
        return out

    def choose(
        self, scene: LightScene, u: Array, p: Array = ORIGIN, n: Array = ORIGIN
    ) -> tuple[Array, Array, Array]:
        """Light, its pmf as light_choose tells, and as light_pmf does, for receivers at p with normals n (n, 3)."""
        out = self._choose(scene, np.stack([u, np.zeros(len(u))], axis=-1), p, n)
        return out[:, 0].astype(np.int64), out[:, 1], out[:, 2]

    def choose_points(
        self, scene: LightScene, u: Array, p: Array = ORIGIN, n: Array = ORIGIN
    ) -> tuple[Array, Array]:
        """Light that points u (n, 2) choose, and (n, 2) the points that are left for samples of it."""
        out = self._choose(scene, u, p, n)
        return out[:, 0].astype(np.int64), out[:, 3:]

    def _choose(self, scene: LightScene, u: Array, p: Array, n: Array) -> Array:
        out = np.empty((len(u), 5), np.float32)
        places = [rows(a, len(u)) for a in (p, n)]
        self._run("choose", out, len(u), scene, np.asarray(u, np.float32), *places)
        return out

    def pmf(self, scene: LightScene, light: Array, p: Array, n: Array = ORIGIN) -> Array:
        """Probabilities of lights (n,) at receivers p with normals n (n, 3)."""
        out = np.empty(len(light), np.float32)
        places = [rows(a, len(light)) for a in (p, n)]
        self._run("pmf", out, len(light), scene, np.asarray(light, np.uint32), *places)
        return out

    def tally(self, scene: LightScene, p: Array, n: Array, told: Array) -> Array:
        """(lights + 1,) how many of all 2^24 uniform numbers lead to each light from one receiver; those for which
        light_choose tells another pmf than told (lights,) are counted last instead."""
        items = 64
        out = np.empty((items, len(scene.lights) + 1), np.uint32)
        at = np.concatenate([p, n]).astype(np.float32)
        self._run("tally", out, items, scene, at, np.asarray(told, np.float32), np.uint32((1 << 24) // items))
        return np.asarray(out.sum(axis=0))

    def sky(self, scene: LightScene, d: Array, n: Any = ORIGIN) -> tuple[Array, Array]:
        """Radiance of the environment in directions d, and its density for receivers of normal n."""
        out = np.empty((len(d), 4), np.float32)
        self._run("sky", out, len(d), scene, np.asarray(d, np.float32), rows(n, len(d)))
        return out[:, :3], out[:, 3]

    @staticmethod
    def uniform(count: int, seed: int, dims: int = 2) -> Array:
        """Random numbers in [0, 1) of 24 bits, as the samplers make them."""
        bits = np.random.default_rng(seed).integers(0, 1 << 24, (count, dims))
        return (bits * 2.0**-24).astype(np.float32)

    @staticmethod
    def grid(side: int) -> Array:
        """(side^2, 2) midpoints of a grid on the unit square: a quadrature rule for smooth integrands."""
        x = (np.arange(side) + 0.5) / side
        return np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2).astype(np.float32)

    @staticmethod
    def chi2_pvalue(counts: Array, expected: Array) -> float:
        """P-value of Pearson's test; bins of fewer than 10 expected are pooled. Both sum to the same."""
        c, e = np.ravel(counts).astype(float), np.ravel(expected).astype(float)
        if c[e == 0].sum() > 0:
            return 0.0  # samples where the density is zero
        order = np.argsort(-e)
        c, e = c[order], e[order]
        small = int(np.searchsorted(-e, -10.0))
        c = np.append(c[:small], c[small:].sum())
        e = np.append(e[:small], e[small:].sum())
        if e[-1] < 10.0:
            c[-2], e[-2] = c[-2] + c[-1], e[-2] + e[-1]
            c, e = c[:-1], e[:-1]
        return float(scipy.stats.chi2.sf(((c - e) ** 2 / e).sum(), len(e) - 1))


def mesh_light(
    bench: LightBench, vertices: Any, faces: Any, shape_flags: int = 0, **more: Any
) -> tuple[LightScene, Array]:
    """(a scene with one mesh light, behind another triangle in the buffers; the areas of its triangles)."""
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.uint32)
    triangles = np.zeros(len(faces) + 1, TRIANGLE)
    triangles["vertex"][1:] = faces
    shapes = np.zeros(1, SHAPE)
    shapes["flags"] = shape_flags
    corners = vertices[faces].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    cdf = np.concatenate([[0.5], quantised_cdf(areas) / STEPS]).astype(np.float32)
    record = bench.light("mesh", first_cdf=1, first_triangle=1, triangle_count=len(faces), shape=0, **more)
    scene = bench.scene([record], emitter_cdf=cdf, triangles=triangles, shapes=shapes, positions=vertices)
    return scene, areas
