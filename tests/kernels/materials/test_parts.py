"""The formulas that materials are made of, against float64."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.materials import Parts, exact_fresnel


@pytest.fixture(scope="module")
def parts(device: Device) -> Parts:
    return Parts(device)


def test_fresnel_everywhere(parts: Parts) -> None:
    rng = np.random.default_rng(3)
    c = np.concatenate([rng.random(50_000), 10.0 ** rng.uniform(-7, 0, 50_000), [0.0, 1.0]]).astype(
        np.float32
    )
    eta = np.exp(rng.uniform(np.log(0.1), np.log(10), len(c))).astype(np.float32)
    out = parts.run("fresnel", [c, eta], (len(c), 2))
    expected, _ = exact_fresnel(c, eta)
    np.testing.assert_allclose(out[:, 0], expected.astype(np.float64), rtol=0, atol=2e-6)


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
