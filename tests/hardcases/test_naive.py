"""The cases can fail: what naive code does in their set-ups lies beyond their bounds, measured here and now."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases import Workbench, cases, run_case, select
from penumbra_kernels.hardcases.benches import meshes
from penumbra_kernels.hardcases.benches.geometry import (
    TRIANGLE,
    Meshes,
    Probe,
    compiled,
    directions,
    rays,
)
from penumbra_kernels.hardcases.benches.launch import Kernels
from penumbra_kernels.hardcases.benches.materials import Parts
from penumbra_kernels.hardcases.benches.samplers import Sequences
from penumbra_kernels.hardcases.geometry import rounded
from penumbra_kernels.hardcases.leaving import leaving

NAIVE = """
#include "base/types.h"
// Moeller and Trumbore 1997, as it is usually written.
static inline bool moeller_trumbore(const float3 o, const float3 d, const float3 a, const float3 b, const float3 c) {
  const float3 e1 = b - a, e2 = c - a, p = cross(d, e2);
  const float inverse = 1.0f / dot(e1, p);
  const float3 s = o - a;
  const float u = dot(s, p) * inverse;
  if (u < 0.0f || u > 1.0f) return false;
  const float3 q = cross(s, e1);
  const float v = dot(d, q) * inverse;
  return v >= 0.0f && u + v <= 1.0f && dot(e2, q) * inverse > 0.0f;
}
__kernel void quad(__global uint *out, const __global float *o, const __global float *d, const __global float *v) {
  const size_t i = get_global_id(0);
  const float3 p = load3(o + 3 * i), w = load3(d + 3 * i);
  const float3 v0 = load3(v), v1 = load3(v + 3), v2 = load3(v + 6), v3 = load3(v + 9);
  out[i] = (moeller_trumbore(p, w, v0, v1, v2) ? 1u : 0u) + (moeller_trumbore(p, w, v0, v2, v3) ? 1u : 0u);
}
// The textbook's quadratic about a unit sphere at the origin.
__kernel void sphere(__global uint *out, const __global float *o, const __global float *d) {
  const size_t i = get_global_id(0);
  const float3 p = load3(o + 3 * i), w = load3(d + 3 * i);
  const float b = dot3(p, w), c = dot3(p, p) - 1.0f;
  out[i] = b * b - dot3(w, w) * c >= 0.0f ? 1u : 0u;
}
// GGX by cosines alone.
__kernel void ggx(__global float *out, const __global float *m, const float alpha) {
  const float z = m[3 * get_global_id(0) + 2], a2 = alpha * alpha;
  const float k = z * z * (a2 - 1.0f) + 1.0f;
  out[get_global_id(0)] = a2 / (PI_F * k * k);
}
// Frisvad 2012 without its branch.
__kernel void frame(__global float *out, const __global float *n) {
  const float3 v = load3(n + 3 * get_global_id(0));
  const float a = 1.0f / (1.0f + v.z);
  out[get_global_id(0)] = length3((float3)(1.0f - v.x * v.x * a, -v.x * v.y * a, -v.x)) - 1.0f;
}
__kernel void unit_interval(__global float *out, const __global uint *x) {
  out[get_global_id(0)] = (float)x[get_global_id(0)] * 0x1p-32f;
}
__kernel void cone(__global float *out, const __global float *ratio) {
  const float r = ratio[get_global_id(0)];
  out[get_global_id(0)] = 1.0f - sqrt(1.0f - r * r);
}
"""


@pytest.fixture(scope="module")
def naive(device: Device) -> Kernels:
    return Kernels(device, "naive", NAIVE)


def _at_the_diagonal(n: int) -> tuple[Any, Any, Any]:
    rng = np.random.default_rng(1)
    corners, _ = meshes.quad((148376.0, 1234.0, -223423.0), 2.0)
    center = corners.mean(axis=0)
    s = rng.uniform(-0.99, 0.99, n) * 2
    targets = center + np.stack([s, s, 0 * s], 1)
    origins = rounded(center + np.array([0, 0, 20]) + rng.uniform(-2, 2, (n, 3)))
    return origins.astype(np.float32), (targets - origins).astype(np.float32), corners.astype(np.float32)


def test_moeller_and_trumbore_lose_rays_at_a_shared_edge(naive: Kernels) -> None:
    hits = np.empty(100_000, np.uint32)
    naive("quad", len(hits), hits, *_at_the_diagonal(len(hits)))
    assert np.mean(hits == 0) > 0.01


def test_the_plain_quadratic_misjudges_a_far_sphere(naive: Kernels) -> None:
    rng = np.random.default_rng(4)
    impact, angle = rng.uniform(0.9, 1.1, 100_000), rng.uniform(0, 2 * np.pi, 100_000)
    d = np.stack([impact * np.cos(angle), impact * np.sin(angle), np.full(len(angle), -1e4)], 1)
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    o = np.tile(np.float32([0, 0, 1e4]), (len(d), 1))
    closest = np.linalg.norm(np.cross(o.astype(float), d.astype(float)), axis=1) / np.linalg.norm(
        d.astype(float), axis=1
    )
    met = np.empty(len(d), np.uint32)
    naive("sphere", len(d), met, o, d)
    assert np.mean((met == 1) != (closest <= 1)) > 0.1


def test_a_cosine_alone_does_not_hold_a_narrow_lobe(naive: Kernels, device: Device) -> None:
    tangent = np.geomspace(1e-6, 1e-2, 10_000)
    m = np.stack([tangent, 0 * tangent, np.ones(len(tangent))], -1)
    m = (m / np.linalg.norm(m, axis=1, keepdims=True)).astype(np.float32)
    exact = 1 / (np.pi * 1e-8 * (m[:, 0].astype(float) ** 2 / 1e-8 + m[:, 2].astype(float) ** 2) ** 2)
    out = np.empty(len(m), np.float32)
    naive("ggx", len(m), out, m, np.float32(1e-4))
    with np.errstate(all="ignore"):
        error = np.abs(out / exact - 1)
    assert not (error <= 1e-5).all()
    assert np.abs(Parts(device).run("density", [m, (1e-4, 1e-4)], (len(m),)) / exact - 1).max() < 1e-5


def test_a_frame_without_a_sign_breaks_at_the_pole(naive: Kernels) -> None:
    n = np.tile(np.float32([1.2e-4, 0, -1 + 1e-8]), (4, 1))
    n[1:] = np.float32([[3e-4, 1e-4, -1], [0, 0, -1], [1e-3, 1e-3, -1 + 1e-6]])
    out = np.empty(len(n), np.float32)
    naive("frame", len(n), out, n)
    assert not (np.abs(out) <= 1e-6).any()


def test_a_word_times_a_power_of_two_is_one(naive: Kernels, device: Device) -> None:
    out = np.empty(2, np.float32)
    naive("unit_interval", 2, out, np.array([2**32 - 1, 2**32 - 128], np.uint32))
    assert out.max() == 1.0
    ours = np.empty((4096, 2), np.uint32)
    Sequences(device)("extremes", 4096, ours, np.uint32(1 << 12))
    assert ours[:, 1].max().view(np.float32) < 1.0


def test_one_minus_the_cosine_loses_a_far_light(naive: Kernels) -> None:
    ratio = np.float32([1e-3, 1e-4])
    out = np.empty(2, np.float32)
    naive("cone", 2, out, ratio)
    exact = ratio.astype(float) ** 2 / 2
    assert (np.abs(out / exact - 1) > [0.01, 0.9]).all()


def test_where_the_compiler_fuses_the_case_tells(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCL's default is FP_CONTRACT ON; every program of ours says OFF."""
    from penumbra_kernels.hardcases.benches import arithmetic

    monkeypatch.setattr(arithmetic, "TEXT", "#pragma OPENCL FP_CONTRACT ON\n" + arithmetic.TEXT)
    a = np.random.default_rng(2).normal(size=1000).astype(np.float32)
    if not (arithmetic.Arithmetic(device)("cross", a, a, a, a)).any():
        pytest.skip("this compiler fuses nothing, even where it may")
    (case,) = select(["contraction"], cases())
    assert run_case(case, Workbench(device)).status == "failed"


def test_a_fixed_epsilon_is_wrong_at_other_scales(device: Device) -> None:
    """Origins moved by 1e-4 along the normal, instead of out of their error box: a millionth of a metre leaks."""
    probe, rng = Probe(device), np.random.default_rng(3)
    unscaled, faces = meshes.box()
    held = Meshes()
    geometry = compiled([held.add(unscaled * 1e-6, faces)], held)
    start = (rng.uniform(0.2, 0.8, (10_000, 3)) * 1e-6).astype(np.float32)
    hit = probe.trace(geometry, rays(start, directions(rng, len(start))), 1.0)
    again = leaving(hit, rng, 1.0)
    assert (probe.trace(geometry, again)["kind"] == TRIANGLE).all()
    again[:, :3] = hit["p"] + 1e-4 * hit["ng"]
    assert np.mean(probe.trace(geometry, again)["kind"] != TRIANGLE) > 0.4


def test_a_spoilt_program_fails_its_case(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mistake in the tracer's own text turns a case red: here the roughness is a thousandth too large."""
    from penumbra_kernels.hardcases.benches import materials

    call = "ggx_d(load3(m + 3 * i), alpha[0]"
    spoilt = materials.PARTS.replace(call, call + " * 1.001f")
    assert spoilt != materials.PARTS
    monkeypatch.setattr(materials, "PARTS", spoilt)
    (case,) = select(["narrow-ggx"], cases())
    assert run_case(case, Workbench(device)).status == "failed"
