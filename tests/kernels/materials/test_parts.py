"""The formulas that materials are made of, against float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.device import Device
from scipy import stats

FALSE_ALARM = 1e-6

KERNELS = """
#include "materials/bsdf.cl"

__kernel void fresnel(const __global float *c, const __global float *eta, __global float *out) {
  const size_t i = get_global_id(0);
  float cos_t;
  out[2 * i] = fresnel_dielectric(c[i], eta[i], &cos_t);
  out[2 * i + 1] = cos_t;
}

__kernel void density(const __global float *m, const __global float *alpha, __global float *out) {
  const size_t i = get_global_id(0);
  out[i] = ggx_d(load3(m + 3 * i), alpha[0], alpha[1]);
}

__kernel void visible(const __global float *u, const __global float *wo, const __global float *alpha,
                      __global float *out) {
  const size_t i = get_global_id(0);
  const float3 m = ggx_sample_visible(load3(wo), alpha[0], alpha[1], (float2)(u[2 * i], u[2 * i + 1]));
  out[3 * i] = m.x;
  out[3 * i + 1] = m.y;
  out[3 * i + 2] = m.z;
}

__kernel void frame(const __global float *n, __global float *out) {
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


class Parts:
    def __init__(self, device: Device) -> None:
        flags = {"PENUMBRA_GLOSS": 1, "PENUMBRA_TRANSMISSION": 1, "PENUMBRA_TEXTURES": 0}
        program = device.build("materials_parts", flags, text=KERNELS)
        self.device = device
        self.kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}

    def run(self, name: str, inputs: list[Any], shape: tuple[int, ...]) -> NDArray[np.float32]:
        out = np.empty(shape, np.float32)
        buffers = [self.device.upload(np.asarray(a, np.float32)) for a in inputs]
        result = self.device.allocate(out.nbytes)
        self.device.launch(self.kernels[name], [*buffers, result], shape[0], 1)
        self.device.download(result, out)
        return out


@pytest.fixture(scope="module")
def parts(device: Device) -> Parts:
    return Parts(device)


def exact_fresnel(
    c: NDArray[Any], eta: NDArray[Any]
) -> tuple[NDArray[np.longdouble], NDArray[np.longdouble]]:
    """Fresnel's amplitudes in extended precision."""
    c, eta = c.astype(np.longdouble), eta.astype(np.longdouble)
    s2 = (1 - c * c) / eta**2
    t = np.sqrt(np.maximum(1 - s2, 0))
    with np.errstate(invalid="ignore"):  # 0/0 at c = 0 beyond the critical angle
        rs, rp = (c - eta * t) / (c + eta * t), (eta * c - t) / (eta * c + t)
    return np.where(s2 < 1, (rs**2 + rp**2) / 2, 1), t


def test_fresnel_holds_at_the_critical_angle(parts: Parts) -> None:
    eta = np.repeat(np.float32([1 / 1.5, 1 / 1.33, 1 / 2.4, 0.9, 0.15, 0.9999]), 4001)
    offset = np.tile(np.linspace(-1e-5, 1e-5, 4001), 6)
    offset += np.tile(np.concatenate([np.linspace(-3e-7, 3e-7, 2001), np.zeros(2000)]), 6)
    c = (np.sqrt(1.0 - eta.astype(np.float64) ** 2) + offset).astype(np.float32)
    out = parts.run("fresnel", [c, eta], (len(c), 2))
    expected, cos_t = exact_fresnel(c, eta)
    assert np.isfinite(out).all()
    assert out[:, 0].max() <= 1.0
    assert (expected < 1).any()
    assert (expected == 1).any()
    np.testing.assert_allclose(out[:, 0], expected.astype(np.float64), rtol=0, atol=2e-6)
    np.testing.assert_allclose(out[:, 1], cos_t.astype(np.float64), rtol=2e-6, atol=1e-9)


def test_fresnel_everywhere(parts: Parts) -> None:
    rng = np.random.default_rng(3)
    c = np.concatenate([rng.random(50_000), 10.0 ** rng.uniform(-7, 0, 50_000), [0.0, 1.0]]).astype(
        np.float32
    )
    eta = np.exp(rng.uniform(np.log(0.1), np.log(10), len(c))).astype(np.float32)
    out = parts.run("fresnel", [c, eta], (len(c), 2))
    expected, _ = exact_fresnel(c, eta)
    np.testing.assert_allclose(out[:, 0], expected.astype(np.float64), rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    "alpha", [(1.0, 1.0), (0.1, 0.1), (1e-3, 1e-3), (1e-4, 1e-4), (0.5, 1e-4), (1e-3, 0.9)]
)
def test_density_of_normals_is_exact_for_narrow_lobes(parts: Parts, alpha: tuple[float, float]) -> None:
    rng = np.random.default_rng(5)
    phi = rng.uniform(0, 2 * np.pi, 100_000)
    tangent = np.exp(rng.uniform(np.log(1e-6), np.log(1e3), len(phi)))
    m = np.stack([tangent * np.cos(phi), tangent * np.sin(phi), np.ones(len(phi))], -1)
    m = (m / np.linalg.norm(m, axis=1, keepdims=True)).astype(np.float32)
    out = parts.run("density", [m, alpha], (len(m),))
    a, b = np.float64(np.float32(alpha))
    x, y, z = m.astype(np.float64).T
    expected = 1.0 / (np.pi * a * b * ((x / a) ** 2 + (y / b) ** 2 + z * z) ** 2)
    np.testing.assert_allclose(out, expected, rtol=2e-6)


def test_density_of_normals_covers_the_plane_once(parts: Parts) -> None:
    # The integral of D cos over the hemisphere is 1, here over tan = sinh-spaced nodes.
    x, w = np.polynomial.legendre.leggauss(400)
    u = 0.5 * (x + 1)
    z = np.sqrt(1 - u)  # sin^2 uniform: cos dw = d(sin^2) d(phi) / 2
    phi = (np.arange(128) + 0.5) * (2 * np.pi / 128)
    m = np.stack(
        np.broadcast_arrays(np.sqrt(u)[:, None] * np.cos(phi), np.sqrt(u)[:, None] * np.sin(phi), z[:, None]),
        -1,
    )
    out = parts.run("density", [m.reshape(-1, 3), (0.3, 0.6)], (m.shape[0] * m.shape[1],))
    total = (out.reshape(m.shape[:2]).astype(np.float64).mean(axis=1) * 0.5 * w).sum() * np.pi
    assert total == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("cosine", [1.0, 0.5, 1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("alpha", [(1e-4, 1e-4), (1e-3, 1e-3), (0.1, 0.1), (1.0, 1.0), (0.5, 1e-3)])
def test_visible_normals(parts: Parts, alpha: tuple[float, float], cosine: float) -> None:
    """Stretched to roughness 1, w mirrored about its visible normals is uniform over the cap of directions
    above -w.z (Dupuy and Benyoub 2023, section 3): both coordinates there are uniform numbers."""
    n = 1_000_000
    rng = np.random.default_rng(17)
    u = rng.integers(0, 1 << 24, (n, 2)) * 2.0**-24
    wo = np.float32([np.sqrt(1 - cosine * cosine) * 0.8, np.sqrt(1 - cosine * cosine) * 0.6, cosine])
    m = parts.run("visible", [u, wo, alpha], (n, 3))
    assert np.isfinite(m).all()
    assert (m[:, 2] > 0).all()
    a = np.float64(np.float32([*alpha, 1.0]))
    w = wo.astype(np.float64) * a
    w /= np.linalg.norm(w)
    standard = m.astype(np.float64) / a * (1, 1, 1)
    standard /= np.linalg.norm(standard, axis=1, keepdims=True)
    cap = 2 * (standard @ w)[:, None] * standard - w
    height = (cap[:, 2] + w[2]) / (1 + w[2])
    angle = np.arctan2(cap[:, 1], cap[:, 0]) / (2 * np.pi) + 0.5
    observed, _, _ = np.histogram2d(height, angle, bins=16, range=[[0, 1], [0, 1]])
    lost = n - observed.sum()
    assert lost <= 20  # heights of 0 and 1 that rounding puts just outside
    statistic = ((observed - observed.sum() / 256) ** 2 / (observed.sum() / 256)).sum()
    assert stats.chi2.sf(statistic, 255) > FALSE_ALARM


def test_frames_are_orthonormal_near_the_pole(parts: Parts) -> None:
    rng = np.random.default_rng(2)
    tilt = 10.0 ** rng.uniform(-9, 0, 20_000)
    phi = rng.uniform(0, 2 * np.pi, len(tilt))
    z = rng.choice([-1.0, 1.0], len(tilt)) * np.sqrt(1 - np.minimum(tilt, 1) ** 2)
    n = np.stack([tilt * np.cos(phi), tilt * np.sin(phi), z], -1)
    n = np.concatenate([n, [[0, 0, 1], [0, 0, -1], [-0.0, 0, -1], [1.2e-4, 0, -1 + 1e-8]]])
    n = (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)
    out = parts.run("frame", [n], (len(n), 6)).astype(np.float64)
    basis = np.stack([out[:, :3], out[:, 3:], n.astype(np.float64)], axis=1)
    gram = basis @ basis.transpose(0, 2, 1)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-6)
    assert np.linalg.det(basis) == pytest.approx(1.0, abs=1e-6)
