"""One material on one surface, scattering many directions on a device; and the formulas that materials are made of.

The local frame unless told: z the surface's normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene

from penumbra_kernels.compile.materials import compile_albedo_table, compile_materials
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.launch import Kernels
from penumbra_kernels.layout import SHAPE

KERNELS: Final = """
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


class MaterialBench:
    """One device with the materials' program, every kind of material in it unless told."""

    FLAT: Final = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    """Geometric normal, shading normal, tangent: the world frame is the local one."""

    def __init__(self, device: Device, gloss: int = 1, transmission: int = 1, textures: int = 0) -> None:
        self.device = device
        flags = {
            "PENUMBRA_GLOSS": gloss,
            "PENUMBRA_TRANSMISSION": transmission,
            "PENUMBRA_TEXTURES": textures,
        }
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
        return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True), np.float32)


TILTED: Final = ((0.0, 0.0, 1.0), (0.28, 0.0, 0.96), (0.96, 0.0, -0.28))
"""A shading normal 16 degrees off the geometric one."""

RECIPROCAL: Final[dict[str, dict[str, Any]]] = {
    "diffuse": {"type": "diffuse"},
    "phong": {"type": "phong", "exponent": 50},
    "metal": {"type": "conductor", "roughness": 0.4, "anisotropy": 0.5, "rotation": 30},
    "rough metal": {"type": "conductor", "roughness": 1},
    "plastic": {"type": "plastic", "roughness": 0.4},
    "smooth plastic": {"type": "plastic", "roughness": 0},
    "glass": {"type": "dielectric", "roughness": 0.5, "color": (0.9, 0.5, 0.2)},
    "rough glass": {"type": "dielectric", "roughness": 1.0, "ior": 2.0},
    "sheet": {"type": "thin_dielectric", "roughness": 0.5, "color": (0.9, 0.5, 0.2)},
    "paper": {"type": "diffuse_transmission"},
}
"""Materials of which f is the same both ways."""

PARTS: Final = """
#include "materials/bsdf.cl"

__kernel void fresnel(__global float *out, const __global float *c, const __global float *eta) {
  const size_t i = get_global_id(0);
  float cos_t;
  out[2 * i] = fresnel_dielectric(c[i], eta[i], &cos_t);
  out[2 * i + 1] = cos_t;
}

__kernel void density(__global float *out, const __global float *m, const __global float *alpha) {
  const size_t i = get_global_id(0);
  out[i] = ggx_d(load3(m + 3 * i), alpha[0], alpha[1]);
}

__kernel void visible(__global float *out, const __global float *u, const __global float *wo, const __global float *alpha) {
  const size_t i = get_global_id(0);
  const float3 m = ggx_sample_visible(load3(wo), alpha[0], alpha[1], (float2)(u[2 * i], u[2 * i + 1]));
  out[3 * i] = m.x;
  out[3 * i + 1] = m.y;
  out[3 * i + 2] = m.z;
}

__kernel void frame(__global float *out, const __global float *n) {
  const size_t i = get_global_id(0);
  float3 s, t;
  make_frame(load3(n + 3 * i), &s, &t);
  out[6 * i] = s.x;
  out[6 * i + 1] = s.y;
  out[6 * i + 2] = s.z;
  out[6 * i + 3] = t.x;
  out[6 * i + 4] = t.y;
  out[6 * i + 5] = t.z;
}
"""


class Parts(Kernels):
    """Fresnel reflectance, the density of normals, visible normals, frames."""

    def __init__(self, device: Device) -> None:
        flags = {"PENUMBRA_GLOSS": 1, "PENUMBRA_TRANSMISSION": 1, "PENUMBRA_TEXTURES": 0}
        super().__init__(device, "materials_parts", PARTS, flags)

    def run(self, name: str, inputs: list[Any], shape: tuple[int, ...]) -> NDArray[np.float32]:
        """What kernel `name` makes of the inputs, one work-item a row."""
        out = np.empty(shape, np.float32)
        self(name, shape[0], out, *(np.asarray(a, np.float32) for a in inputs))
        return out


def exact_fresnel(
    c: NDArray[Any], eta: NDArray[Any]
) -> tuple[NDArray[np.longdouble], NDArray[np.longdouble]]:
    """Fresnel's reflectance and the refracted cosine, in extended precision."""
    c, eta = c.astype(np.longdouble), eta.astype(np.longdouble)
    s2 = (1 - c * c) / eta**2
    t = np.sqrt(np.maximum(1 - s2, 0))
    with np.errstate(invalid="ignore"):  # 0/0 at c = 0 beyond the critical angle
        rs, rp = (c - eta * t) / (c + eta * t), (eta * c - t) / (eta * c + t)
    return np.where(s2 < 1, (rs**2 + rp**2) / 2, 1), t


def albedo_of(
    bench: MaterialBench, material: dict[str, Any], cosine: float, eta: float = 1.0, samples: int = 100_000
) -> tuple[float, float]:
    """Mean energy that leaves, first channel, and its standard error. eta: far index over near index; what is transmitted
    is radiance there times eta^2."""
    s = bench.sample(material, bench.toward(cosine, 0.9), bench.uniforms(samples, 23))
    energy = np.where(s.alive, s.weight[:, 0].astype(np.float64), 0.0)
    energy *= np.where(s.transmitted, eta * eta, 1.0)
    return float(energy.mean()), float(energy.std() / np.sqrt(samples))


def function_of(
    bench: MaterialBench, material: Any, frame: Any, wo: NDArray[Any], wi: NDArray[Any]
) -> NDArray[np.float64]:
    """f, without the cosine, divided by the square of the index on the side of wo (Veach 1997, eq. 5.14)."""
    value, _ = bench.evaluate(material, wo, wi, frame)
    cosine = np.abs(wi.astype(np.float64) @ np.asarray(frame[1]))
    index = np.where(wo.astype(np.float64) @ np.asarray(frame[0]) < 0, material.get("ior", 1.5), 1.0)
    if material["type"] != "dielectric":
        index = np.ones(len(wi))
    return np.asarray(value / (cosine * index**2)[:, None])
