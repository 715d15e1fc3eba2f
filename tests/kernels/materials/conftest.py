"""A bench for one material on one surface: scatters many directions on a device and hands the numbers back as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.materials import compile_albedo_table, compile_materials
from penumbra_kernels.device import Device
from penumbra_kernels.layout import CONSTANTS, MATERIAL
from penumbra_scene.scene import Scene

KERNELS = """
#include "materials/bsdf.cl"

static inline Surface surface_of(const __global float *frame, const float2 uv) {
  Surface s;
  s.p = s.p_error = (float3)(0.0f);
  s.ng = load3(frame);
  s.ns = load3(frame + 3);
  s.tangent = load3(frame + 6);
  s.uv = uv;
  s.shape = 0u;
  s.instance = NONE;
  s.kind = s.primitive = 0u;
  return s;
}

static inline SceneData scene_of(const __global ShapeData *shapes, const __global Material *materials,
                                 const __global float *table) {
  SceneData scene;
  scene.shapes = shapes;
  scene.materials = materials;
  scene.albedo_table = table;
  return scene;
}

__kernel void sample(const __global ShapeData *shapes, const __global Material *materials, const __global float *table,
                     const __global float *frame, const __global float *wo, const __global float *u,
                     __global float *direction, __global float *weight, __global float *pdf, __global int *event) {
  const size_t i = get_global_id(0);
  const SceneData scene = scene_of(shapes, materials, table);
  const Surface surface = surface_of(frame, (float2)(0.0f));
  Bsdf b;
  bsdf_start(&scene, &surface, load3(wo + 3 * i), &b);
  float3 wi = (float3)(0.0f), w = (float3)(0.0f);
  float p = 0.0f;
  uint e = 0u;
  const bool goes_on = bsdf_sample(&b, u[3 * i], (float2)(u[3 * i + 1], u[3 * i + 2]), &wi, &w, &p, &e);
  direction[3 * i] = wi.x; direction[3 * i + 1] = wi.y; direction[3 * i + 2] = wi.z;
  weight[3 * i] = w.x; weight[3 * i + 1] = w.y; weight[3 * i + 2] = w.z;
  pdf[i] = p;
  event[i] = goes_on ? (int)e : -1;
}

__kernel void evaluate(const __global ShapeData *shapes, const __global Material *materials, const __global float *table,
                       const __global float *frame, const __global float *wo, const __global float *wi,
                       __global float *value, __global float *pdf) {
  const size_t i = get_global_id(0);
  const SceneData scene = scene_of(shapes, materials, table);
  const Surface surface = surface_of(frame, (float2)(0.0f));
  Bsdf b;
  bsdf_start(&scene, &surface, load3(wo + 3 * i), &b);
  float p;
  const float3 f = bsdf_eval(&b, load3(wi + 3 * i), &p);
  value[3 * i] = f.x; value[3 * i + 1] = f.y; value[3 * i + 2] = f.z;
  pdf[i] = p;
}

__kernel void describe(const __global ShapeData *shapes, const __global Material *materials, const __global float *table,
                       const __global float *frame, const __global float *wo, __global float *albedo,
                       __global int *smooth) {
  const size_t i = get_global_id(0);
  const SceneData scene = scene_of(shapes, materials, table);
  const Surface surface = surface_of(frame, (float2)(0.0f));
  Bsdf b;
  bsdf_start(&scene, &surface, load3(wo + 3 * i), &b);
  const float3 a = bsdf_albedo(&b);
  albedo[3 * i] = a.x; albedo[3 * i + 1] = a.y; albedo[3 * i + 2] = a.z;
  smooth[i] = bsdf_has_smooth(&b) ? 1 : 0;
}
"""

ALL = {"PENUMBRA_GLOSS": 1, "PENUMBRA_TRANSMISSION": 1, "PENUMBRA_TEXTURES": 0}
DELTA, TRANSMIT = 1, 2
FLAT = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
"""Geometric normal, shading normal, tangent: the world frame is the local one."""


@dataclass(frozen=True)
class Samples:
    """What bsdf_sample returned, one row a sample; event -1 where the light ended."""

    wi: NDArray[np.float32]
    weight: NDArray[np.float32]
    pdf: NDArray[np.float32]
    event: NDArray[np.int32]

    @property
    def alive(self) -> NDArray[np.bool_]:
        return self.event >= 0


def material_scene(**material: Any) -> Scene:
    """The smallest scene with one material, named m."""
    return Scene.model_validate(
        {"version": 1, "camera": {"type": "perspective"}, "materials": {"m": material}}
    )


@lru_cache(maxsize=256)
def _compiled(text: str) -> tuple[NDArray[Any], NDArray[np.float32]]:
    scene = Scene.model_validate_json(text)
    materials, index = compile_materials(scene, {})
    return materials[index["m"] : index["m"] + 1], compile_albedo_table(materials)


class Bench:
    """One device with the materials' program."""

    def __init__(self, device: Device, flags: dict[str, int]) -> None:
        self.device = device
        self.program = device.build("materials_bench", flags, text=KERNELS)

    def _run(
        self,
        name: str,
        material: dict[str, Any] | NDArray[Any],
        frame: Any,
        inputs: list[Any],
        outputs: list[Any],
    ) -> None:
        if isinstance(material, dict):
            record, table = _compiled(material_scene(**material).model_dump_json())
        else:
            record, table = material, np.zeros(1, np.float32)
        from penumbra_kernels.layout import SHAPE

        shape = np.zeros(1, SHAPE)
        arguments = [shape, record, table, np.asarray(frame, np.float32), *inputs]
        buffers = [self.device.upload(a) for a in arguments]
        results = [self.device.allocate(a.nbytes) for a in outputs]
        count = len(outputs[-1])
        self.device.launch(getattr(self.program, name), [*buffers, *results], count, 1)
        for buffer, array in zip(results, outputs, strict=True):
            self.device.download(buffer, array)

    def sample(self, material: Any, wo: Any, u: NDArray[Any], frame: Any = FLAT) -> Samples:
        """bsdf_sample for every row of u (n, 3): lobe, then direction. wo: (3,) or (n, 3)."""
        n = len(u)
        out = Samples(
            np.empty((n, 3), np.float32),
            np.empty((n, 3), np.float32),
            np.empty(n, np.float32),
            np.empty(n, np.int32),
        )
        rows = np.ascontiguousarray(np.broadcast_to(np.asarray(wo, np.float32), (n, 3)))
        self._run(
            "sample", material, frame, [rows, u.astype(np.float32)], [out.wi, out.weight, out.pdf, out.event]
        )
        return out

    def evaluate(
        self, material: Any, wo: Any, wi: Any, frame: Any = FLAT
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """bsdf_eval: values (n, 3) = f cos, and densities (n,)."""
        wi = np.ascontiguousarray(np.atleast_2d(np.asarray(wi, np.float32)))
        rows = np.ascontiguousarray(np.broadcast_to(np.asarray(wo, np.float32), wi.shape))
        value, pdf = np.empty((len(wi), 3), np.float32), np.empty(len(wi), np.float32)
        self._run("evaluate", material, frame, [rows, wi], [value, pdf])
        return value, pdf

    def describe(
        self, material: Any, wo: Any, frame: Any = FLAT
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """bsdf_albedo (n, 3) and bsdf_has_smooth (n,)."""
        rows = np.ascontiguousarray(np.atleast_2d(np.asarray(wo, np.float32)))
        albedo, smooth = np.empty((len(rows), 3), np.float32), np.empty(len(rows), np.int32)
        self._run("describe", material, frame, [rows], [albedo, smooth])
        return albedo, smooth


_benches: dict[tuple[str, tuple[tuple[str, int], ...]], Bench] = {}


def bench_of(device: Device, flags: dict[str, int]) -> Bench:
    """Built once per device and flags."""
    key = (device.info.id, tuple(sorted(flags.items())))
    if key not in _benches:
        _benches[key] = Bench(device, flags)
    return _benches[key]


@pytest.fixture(scope="session")
def bench(device: Device) -> Bench:
    """The program with every material."""
    return bench_of(device, ALL)


def uniforms(n: int, seed: int) -> NDArray[np.float32]:
    """(n, 3) numbers as the samplers draw them: multiples of 2^-24 below 1."""
    rng = np.random.default_rng(seed)
    return (rng.integers(0, 1 << 24, (n, 3)) * 2.0**-24).astype(np.float32)


def toward(cosine: float, azimuth: float = 0.0) -> tuple[float, float, float]:
    """The unit direction with that z."""
    sine = float(np.sqrt((1.0 - cosine) * (1.0 + cosine)))
    return sine * float(np.cos(azimuth)), sine * float(np.sin(azimuth)), cosine


__all__ = [
    "ALL",
    "CONSTANTS",
    "DELTA",
    "FLAT",
    "MATERIAL",
    "TRANSMIT",
    "Bench",
    "Samples",
    "bench_of",
    "toward",
    "uniforms",
]
