"""Claims about cl/materials/*16.cl: sixteen lanes of materials are, bit for bit, what the functions of one lane give."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import Image, MeshData
from penumbra_kernels.compile.materials import compile_albedo_table, compile_materials
from penumbra_kernels.compile.textures import compile_textures
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.launch import Kernels
from penumbra_kernels.layout import SHAPE
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene

INPUT: Final = 24
"""Floats of a lane: wo, ng, ns, tangent, uv, wi, u_lobe, u, shape, whether it is on."""
OUTPUT: Final = 40

ARGUMENTS: Final = """__global float *out, const __global float *in, const __global ShapeData *shapes,
    const __global Material *materials, const __global float *table, const __global Texture *textures,
    const __global float4 *texels"""
KERNELS: Final = f"""
#include "materials/bsdf16.cl"

static inline SceneData scene_of(const __global ShapeData *shapes, const __global Material *materials,
                                 const __global float *table, const __global Texture *textures,
                                 const __global float4 *texels) {{
  SceneData scene;
  scene.shapes = shapes;
  scene.materials = materials;
  scene.albedo_table = table;
  scene.textures = textures;
  scene.texels = texels;
  return scene;
}}

static inline Surface surface_of(const __global float *in) {{
  Surface s;
  s.p = s.p_error = (float3)(0.0f);
  s.ng = load3(in + 3);
  s.ns = load3(in + 6);
  s.tangent = load3(in + 9);
  s.uv = (float2)(in[12], in[13]);
  s.shape = (uint)in[20];
  s.instance = NONE;
  s.kind = s.primitive = 0u;
  return s;
}}

static inline void store3(__global float *p, const float3 v) {{
  p[0] = v.x;
  p[1] = v.y;
  p[2] = v.z;
}}

static inline void store_state(__global float *out, const Bsdf *b) {{
  store3(out, b->s);
  store3(out + 3, b->t);
  store3(out + 6, b->n);
  store3(out + 9, b->ng);
  store3(out + 12, b->wo);
  store3(out + 15, b->color0);
  out[18] = (float)b->type;
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  store3(out + 19, b->color1);
  out[22] = b->eta;
#endif
}}

static inline float flags_of(const bool smooth, const bool has_smooth, const bool spread, const bool transmits,
                             const bool lobes, const bool wide) {{
  return (smooth ? 1.0f : 0.0f) + (has_smooth ? 2.0f : 0.0f) + (spread ? 4.0f : 0.0f) + (transmits ? 8.0f : 0.0f) +
         (lobes ? 16.0f : 0.0f) + (wide ? 32.0f : 0.0f);
}}

static inline void store_sample(__global float *out, const bool alive, const float3 wi, const float3 weight, const float pdf,
                                const uint event) {{
  out[0] = alive ? 1.0f : 0.0f;
  if (!alive) return;
  store3(out + 1, wi);
  store3(out + 4, weight);
  out[7] = pdf;
  out[8] = (float)event;
}}

__kernel void one({ARGUMENTS}) {{
  const size_t i = get_global_id(0);
  in += {INPUT} * i;
  out += {OUTPUT} * i;
  const SceneData scene = scene_of(shapes, materials, table, textures, texels);
  const Surface surface = surface_of(in);
  for (uint j = 0u; j < {OUTPUT}u; j++) out[j] = 0.0f;
  Bsdf b;
  bsdf_start(&scene, &surface, load3(in), &b);
  store_state(out, &b);
  out[23] = flags_of(b.smooth, bsdf_has_smooth(&b), bsdf_has_spread(&b), bsdf_transmits(&b),
                     bsdf_has_lobes(&b), bsdf_is_wide(&b));
  float3 wi, weight;
  float pdf;
  store3(out + 24, bsdf_eval(&b, load3(in + 14), &pdf));
  out[27] = pdf;
  uint event;
  const bool alive = bsdf_sample(&b, in[17], (float2)(in[18], in[19]), &wi, &weight, &pdf, &event);
  store_sample(out + 28, alive, wi, weight, pdf, event);
  store3(out + 37, bsdf_albedo(&b));
}}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void together({ARGUMENTS}) {{
  const SceneData scene = scene_of(shapes, materials, table, textures, texels);
  Surface16 surface;
  Vec16 wo, wi;
  float16 u_lobe;
  Point16 u;
  Mask16 on;
  for (uint k = 0u; k < LANES; k++) {{
    const __global float *lane = in + {INPUT}u * k;
    const Surface s = surface_of(lane);
    set_lane_surface(&surface, k, &s);
    set_lane3(&wo, k, load3(lane));
    set_lane3(&wi, k, load3(lane + 14));
    LANE_F(u_lobe, k) = lane[17];
    LANE_F(u.x, k) = lane[18];
    LANE_F(u.y, k) = lane[19];
    LANE_I(on, k) = lane[21] != 0.0f ? -1 : 0;
  }}
  Bsdf16 b;
  bsdf_start16(&scene, &surface, wo, on, &b);
  const Mask16 has_smooth = bsdf_has_smooth16(&b), spread = bsdf_has_spread16(&b), transmits = bsdf_transmits16(&b);
  const Mask16 lobes = bsdf_has_lobes16(&b), wide = bsdf_is_wide16(&b);
  float16 pdf, sampled_pdf;
  const Vec16 value = bsdf_eval16(&scene, &b, wi, on, &pdf), albedo = bsdf_albedo16(&scene, &b, on);
  Vec16 drawn, weight;
  uint16 event;
  const Mask16 alive = bsdf_sample16(&scene, &b, u_lobe, u, on, &drawn, &weight, &sampled_pdf, &event);
  for (uint k = 0u; k < LANES; k++) {{
    __global float *row = out + {OUTPUT}u * k;
    for (uint j = 0u; j < {OUTPUT}u; j++) row[j] = 0.0f;
    if (!LANE_I(on, k)) continue;
    const Bsdf one = lane_bsdf(&scene, &b, k);
    store_state(row, &one);
    row[23] = flags_of(one.smooth, LANE_I(has_smooth, k), LANE_I(spread, k), LANE_I(transmits, k),
                       LANE_I(lobes, k), LANE_I(wide, k));
    store3(row + 24, lane3(&value, k));
    row[27] = LANE_F(pdf, k);
    store_sample(row + 28, LANE_I(alive, k) != 0, lane3(&drawn, k), lane3(&weight, k), LANE_F(sampled_pdf, k),
                 LANE_U(event, k));
    store3(row + 37, lane3(&albedo, k));
  }}
}}

__kernel void sixteen({ARGUMENTS}) {{
  const size_t i = get_global_id(0);
  together(out + {OUTPUT}u * LANES * i, in + {INPUT}u * LANES * i, shapes, materials, table, textures, texels);
}}
"""

RED: Final = (0.7, 0.2, 0.1)
PLAIN: Final[list[dict[str, Any]]] = [
    {"type": "diffuse", "base_color": RED},
    {"type": "diffuse", "base_color": (0.0, 1.0, 0.5)},
]
GLOSSY: Final[list[dict[str, Any]]] = [
    {"type": "mirror", "color": RED},
    {"type": "conductor", "roughness": 0.0},
    {"type": "conductor", "roughness": 0.3, "base_color": RED},
    {"type": "conductor", "roughness": 0.3, "energy_compensation": False},
    {"type": "conductor", "roughness": 0.011},
    {"type": "conductor", "roughness": 1.0, "fresnel": False},
    {"type": "conductor", "roughness": 0.6, "anisotropy": 0.7, "rotation": 40, "base_color": RED},
    {"type": "conductor", "roughness": 0.5, "anisotropy": 0.9, "rotation": 300, "fresnel": False},
    {"type": "plastic", "roughness": 0.0, "base_color": RED},
    {"type": "plastic", "roughness": 0.4},
    {"type": "phong", "exponent": 40},
]
CLEAR: Final[list[dict[str, Any]]] = [
    {"type": "dielectric", "roughness": 0.0, "ior": 1.5, "color": RED},
    {"type": "dielectric", "roughness": 0.0, "ior": 1.0},
    {"type": "dielectric", "roughness": 0.3, "ior": 1.5, "color": RED},
    {"type": "dielectric", "roughness": 1.0, "ior": 2.4},
    {"type": "dielectric", "roughness": 0.6, "ior": 1.3, "energy_compensation": False},
    {"type": "dielectric", "roughness": 0.5, "ior": 1.5, "anisotropy": 0.6, "rotation": 20},
    {"type": "dielectric", "roughness": 0.011, "ior": 1.33},
    {"type": "thin_dielectric", "roughness": 0.0},
    {"type": "thin_dielectric", "roughness": 0.5, "color": RED},
    {"type": "diffuse_transmission", "reflectance": RED, "transmittance": (0.1, 0.8, 0.2)},
]
TEXTURED: Final[list[dict[str, Any]]] = [
    {"type": "diffuse", "base_color": {"texture": name}} for name in ("squares", "picture", "tiles", "blocks")
] + [
    {"type": "conductor", "roughness": 0.4, "base_color": {"texture": "picture"}},
    {
        "type": "diffuse_transmission",
        "reflectance": {"texture": "squares"},
        "transmittance": {"texture": "picture"},
    },
]
PICTURE: Final = {"type": "image", "image": {"file": "a.png"}}
TEXTURES: Final[dict[str, Any]] = {
    "squares": {
        "type": "checker",
        "color0": RED,
        "color1": 0.9,
        "uv": {"scale": (3.0, 5.0), "offset": (0.1, 0.0)},
    },
    "picture": {**PICTURE, "wrap": "mirror", "uv": {"scale": (2.0, -1.5)}},
    "tiles": {**PICTURE, "uv": {"scale": (3.0, 2.0)}},
    "blocks": {**PICTURE, "filter": "nearest", "wrap": "clamp"},
}

PROGRAMS: Final = {
    # name: gloss, transmission, textures, materials
    "diffuse": (0, 0, 0, PLAIN),
    "metals and plastics": (1, 0, 0, PLAIN + GLOSSY),
    "paper": (0, 1, 0, [*PLAIN, CLEAR[-1]]),
    "everything": (1, 1, 1, PLAIN + GLOSSY + CLEAR + TEXTURED),
}


class OnePicture:
    """Assets with a single image."""

    def image(self, ref: AssetRef) -> Image:
        pixels = np.random.default_rng(5).random((5, 7, 3), np.float32)
        return Image(pixels, eight_bit=False)

    def mesh(self, ref: AssetRef) -> MeshData:
        raise AssertionError(ref)


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _lanes(n: int, materials: int, seed: int) -> NDArray[np.float32]:
    """(n, INPUT) hits: viewers and lights on both sides, grazing, straight above, behind bent shading normals; numbers at the
    ends of their range; places that are not finite."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((n, INPUT))
    ng = _unit(rng.standard_normal((n, 3)))
    ng[rng.random(n) < 0.1] = (0.0, 0.0, -1.0)
    bend = np.where(rng.random(n) < 0.5, 0.0, rng.choice([0.01, 0.3, 1.0], n))
    ns = _unit(ng + bend[:, None] * rng.standard_normal((n, 3)))
    ns *= np.where((ns * ng).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    tangent = _unit(np.cross(ns, rng.standard_normal((n, 3))))

    def direction() -> NDArray[np.float64]:
        height = rng.choice([1.0, 0.3, 1e-3, 1e-7, 0.0], n, p=[0.7, 0.15, 0.05, 0.05, 0.05])
        d = rng.standard_normal((n, 3))
        along = (d * ns).sum(axis=1)[:, None] * ns
        return _unit(np.where(rng.random(n)[:, None] < 0.05, ns, d - along + height[:, None] * along))

    wo = direction()
    wi = direction()
    mirrored = 2.0 * (wo * ns).sum(axis=1)[:, None] * ns - wo
    near = rng.random(n) < 0.4
    wi[near] = _unit(mirrored + rng.choice([0.0, 1e-4, 0.05, 0.5], n)[:, None] * rng.standard_normal((n, 3)))[
        near
    ]
    back = rng.random(n) < 0.05
    wi[back] = -wo[back]
    rows[:, 0:3], rows[:, 3:6], rows[:, 6:9], rows[:, 9:12], rows[:, 14:17] = wo, ng, ns, tangent, wi
    rows[:, 12:14] = rng.choice([1.0, 0.0, 1e9, np.inf, np.nan], (n, 2), p=[0.9, 0.04, 0.02, 0.02, 0.02])
    rows[:, 12:14] *= rng.uniform(-2.0, 2.0, (n, 2))
    u = rng.integers(0, 1 << 24, (n, 3)) * 2.0**-24
    ends = rng.random((n, 3))
    rows[:, 17:20] = np.where(ends < 0.03, 0.0, np.where(ends > 0.97, 1.0 - 2.0**-24, u))
    rows[:, 20] = rng.integers(0, materials, n)
    share = np.repeat(rng.choice([1.0, 0.5, 0.1, 0.0], n // 16, p=[0.5, 0.3, 0.1, 0.1]), 16)
    rows[:, 21] = rng.random(n) < share
    # Sixteen lanes of one material, too.
    same = np.repeat(rng.random(n // 16) < 0.3, 16)
    rows[same, 20] = np.repeat(rows[::16, 20], 16)[same]
    return rows.astype(np.float32)


def _compiled(materials: list[dict[str, Any]]) -> list[NDArray[Any]]:
    """Shapes, an own one for each material and one that is black; materials, albedo table, textures, texels."""
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "perspective"},
            "materials": {str(i): m for i, m in enumerate(materials)},
            "textures": TEXTURES,
        }
    )
    textures, texels, texture_index = compile_textures(scene, OnePicture())
    records, index = compile_materials(scene, texture_index)
    shapes = np.zeros(len(materials) + 1, SHAPE)
    shapes["material"] = [index[str(i)] for i in range(len(materials))] + [1]
    return [shapes, records, compile_albedo_table(records), textures, texels]


def _bits(rows: NDArray[np.float32]) -> NDArray[np.uint32]:
    """NaNs are one value."""
    return np.where(np.isnan(rows), np.float32(np.nan), rows).view(np.uint32)


def _variants(device: Device) -> list[dict[str, int]]:
    portable = {"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0}
    return [dict(device.flags), portable]


@pytest.mark.parametrize("portable", [False, True], ids=["native", "portable"])
@pytest.mark.parametrize("name", list(PROGRAMS))
def test_each_lane_is_what_one_gives(device: Device, name: str, portable: bool) -> None:
    gloss, transmission, with_textures, materials = PROGRAMS[name]
    flags = {
        "PENUMBRA_GLOSS": gloss,
        "PENUMBRA_TRANSMISSION": transmission,
        "PENUMBRA_TEXTURES": with_textures,
    }
    kernels = Kernels(device, "materials16", KERNELS, {**_variants(device)[portable], **flags})
    scene = _compiled(materials)
    n = 16 * (500 if portable else 8000)
    rows = _lanes(n, len(materials) + 1, 11)
    on = rows[:, 21] != 0.0
    one, sixteen = np.empty((n, OUTPUT), np.float32), np.empty((n, OUTPUT), np.float32)
    kernels("one", n, one, rows, *scene)
    kernels("sixteen", n // 16, sixteen, rows, *scene)
    differs = (_bits(one) != _bits(sixteen)) & on[:, None]
    assert not differs.any(), _told(rows, one, sixteen, differs)
    assert one[on, 28].mean() > 0.3
    assert (one[on, 27] > 0).mean() > 0.1


def _told(rows: NDArray[Any], one: NDArray[Any], sixteen: NDArray[Any], differs: NDArray[np.bool_]) -> str:
    k = int(np.flatnonzero(differs.any(axis=1))[0])
    columns = np.flatnonzero(differs[k])
    return f"{differs.sum()} places; lane {k}, material {rows[k, 20]:.0f}, {columns}: {one[k, columns]} {sixteen[k, columns]}"
