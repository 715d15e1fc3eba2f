"""A bench for one material on one surface: scatters many directions on a device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.materials import compile_albedo_table, compile_materials
from penumbra_kernels.device import Device
from penumbra_kernels.layout import SHAPE
from penumbra_scene.scene import Scene

KERNELS = """
#include "materials/bsdf.cl"

static inline void begin(const __global ShapeData *shapes, const __global Material *materials,
                         const __global float *table, const __global float *frame, const float3 wo, Bsdf *b) {
  SceneData scene;
  scene.shapes = shapes;
  scene.materials = materials;
  scene.albedo_table = table;
  Surface s;
  s.ng = load3(frame);
  s.ns = load3(frame + 3);
  s.tangent = load3(frame + 6);
  s.uv = (float2)(0.0f);
  s.shape = 0u;
  bsdf_start(&scene, &s, wo, b);
}

static inline void store3(__global float *p, const float3 v) {
  p[0] = v.x;
  p[1] = v.y;
  p[2] = v.z;
}

__kernel void sample(const __global ShapeData *shapes, const __global Material *materials,
                     const __global float *table, const __global float *frame, const __global float *wo,
                     const __global float *u, __global float *direction, __global float *weight,
                     __global float *pdf, __global int *event) {
  const size_t i = get_global_id(0);
  Bsdf b;
  begin(shapes, materials, table, frame, load3(wo + 3 * i), &b);
  float3 wi = (float3)(0.0f), w = (float3)(0.0f);
  float p = 0.0f;
  uint e = 0u;
  const bool goes_on = bsdf_sample(&b, u[3 * i], (float2)(u[3 * i + 1], u[3 * i + 2]), &wi, &w, &p, &e);
  store3(direction + 3 * i, wi);
  store3(weight + 3 * i, w);
  pdf[i] = p;
  event[i] = goes_on ? (int)e : -1;
}

__kernel void evaluate(const __global ShapeData *shapes, const __global Material *materials,
                       const __global float *table, const __global float *frame, const __global float *wo,
                       const __global float *wi, __global float *value, __global float *pdf) {
  const size_t i = get_global_id(0);
  Bsdf b;
  begin(shapes, materials, table, frame, load3(wo + 3 * i), &b);
  float p;
  store3(value + 3 * i, bsdf_eval(&b, load3(wi + 3 * i), &p));
  pdf[i] = p;
}

__kernel void describe(const __global ShapeData *shapes, const __global Material *materials,
                       const __global float *table, const __global float *frame, const __global float *wo,
                       __global float *albedo, __global int *smooth) {
  const size_t i = get_global_id(0);
  Bsdf b;
  begin(shapes, materials, table, frame, load3(wo + 3 * i), &b);
  store3(albedo + 3 * i, bsdf_albedo(&b));
  smooth[i] = bsdf_has_smooth(&b) ? 1 : 0;
}
"""

DELTA, TRANSMIT = 1, 2


@dataclass(frozen=True)
class Samples:
    """What bsdf_sample returned, one row a sample; event -1 where the light ended."""

    wi: NDArray[np.float32]
    weight: NDArray[np.float32]
    pdf: NDArray[np.float32]
    event: NDArray[np.int32]

    @property
    def alive(self) -> NDArray[np.bool_]:
        return np.asarray(self.event >= 0)

    @property
    def delta(self) -> NDArray[np.bool_]:
        return self.alive & (self.event & DELTA > 0)

    @property
    def transmitted(self) -> NDArray[np.bool_]:
        return self.alive & (self.event & TRANSMIT > 0)


def material_scene(**material: Any) -> Scene:
    """The smallest scene with one material, named m."""
    return Scene.model_validate(
        {"version": 1, "camera": {"type": "perspective"}, "materials": {"m": material}}
    )


@lru_cache(maxsize=512)
def _compiled(text: str) -> tuple[NDArray[Any], NDArray[np.float32]]:
    materials, index = compile_materials(Scene.model_validate_json(text), {})
    return materials[index["m"] : index["m"] + 1], compile_albedo_table(materials)


class Bench:
    """One device with the materials' program."""

    FLAT = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    """Geometric normal, shading normal, tangent: the world frame is the local one."""

    def __init__(self, device: Device, flags: dict[str, int]) -> None:
        self.device = device
        program = device.build("materials_bench", flags, text=KERNELS)
        self.kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}

    def _run(self, name: str, material: Any, frame: Any, inputs: list[Any], outputs: list[Any]) -> None:
        record, table = _compiled(material_scene(**material).model_dump_json())
        arguments = [np.zeros(1, SHAPE), record, table, np.asarray(frame, np.float32), *inputs]
        buffers = [self.device.upload(a) for a in arguments]
        results = [self.device.allocate(a.nbytes) for a in outputs]
        self.device.launch(self.kernels[name], [*buffers, *results], len(outputs[-1]), 1)
        for buffer, array in zip(results, outputs, strict=True):
            self.device.download(buffer, array)

    def sample(self, material: Any, wo: Any, u: NDArray[Any], frame: Any = FLAT) -> Samples:
        """bsdf_sample for every row of u (n, 3): lobe, then direction. wo: (3,) or (n, 3)."""
        n = len(u)
        wi, weight = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        pdf, event = np.empty(n, np.float32), np.empty(n, np.int32)
        rows = np.ascontiguousarray(np.broadcast_to(np.asarray(wo, np.float32), (n, 3)))
        self._run("sample", material, frame, [rows, u.astype(np.float32)], [wi, weight, pdf, event])
        return Samples(wi, weight, pdf, event)

    def evaluate(self, material: Any, wo: Any, wi: Any, frame: Any = FLAT) -> tuple[Any, Any]:
        """bsdf_eval: values f cos (n, 3), and densities (n,)."""
        wi = np.ascontiguousarray(np.atleast_2d(np.asarray(wi, np.float32)))
        rows = np.ascontiguousarray(np.broadcast_to(np.asarray(wo, np.float32), wi.shape))
        value, pdf = np.empty((len(wi), 3), np.float32), np.empty(len(wi), np.float32)
        self._run("evaluate", material, frame, [rows, wi], [value, pdf])
        return value, pdf

    def describe(self, material: Any, wo: Any, frame: Any = FLAT) -> tuple[Any, Any]:
        """bsdf_albedo (n, 3) and bsdf_has_smooth (n,)."""
        rows = np.ascontiguousarray(np.atleast_2d(np.asarray(wo, np.float32)))
        albedo, smooth = np.empty((len(rows), 3), np.float32), np.empty(len(rows), np.int32)
        self._run("describe", material, frame, [rows], [albedo, smooth])
        return albedo, smooth

    @staticmethod
    def uniforms(n: int, seed: int) -> NDArray[np.float32]:
        """(n, 3) numbers as the samplers draw them: multiples of 2^-24 below 1."""
        rng = np.random.default_rng(seed)
        return (rng.integers(0, 1 << 24, (n, 3)) * 2.0**-24).astype(np.float32)

    @staticmethod
    def toward(cosine: float, azimuth: float = 0.0) -> tuple[float, float, float]:
        """The unit direction with that z."""
        sine = float(np.sqrt((1.0 - cosine) * (1.0 + cosine)))
        return sine * float(np.cos(azimuth)), sine * float(np.sin(azimuth)), cosine

    @staticmethod
    def directions(n: int, seed: int) -> NDArray[np.float32]:
        """(n, 3) uniform directions over the whole sphere."""
        d = np.random.default_rng(seed).standard_normal((n, 3))
        return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


_benches: dict[tuple[str, tuple[tuple[str, int], ...]], Bench] = {}


@pytest.fixture(scope="session")
def bench_with(device: Device) -> Callable[[int, int, int], Bench]:
    """Benches by their flags (gloss, transmission, textures), each built once."""

    def make(gloss: int, transmission: int, textures: int) -> Bench:
        flags = {"GLOSS": gloss, "TRANSMISSION": transmission, "TEXTURES": textures}
        key = (device.info.id, tuple(sorted(flags.items())))
        if key not in _benches:
            _benches[key] = Bench(device, {f"PENUMBRA_{name}": value for name, value in flags.items()})
        return _benches[key]

    return make


@pytest.fixture(scope="session")
def bench(bench_with: Callable[[int, int, int], Bench]) -> Bench:
    """The program with every material."""
    return bench_with(1, 1, 0)
