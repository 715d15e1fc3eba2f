"""Directions are drawn with the density that bsdf_eval states, for every material, up to grazing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

FALSE_ALARM = 1e-6
SAMPLES = 200_000
HEIGHTS, AZIMUTHS = 40, 32
"""Cells of the sphere, evenly spaced in z and azimuth."""

Density = Callable[[NDArray[np.float64]], NDArray[np.float32]]

MATERIALS: dict[str, dict[str, Any]] = {
    "diffuse": {"type": "diffuse"},
    "phong 0": {"type": "phong", "exponent": 0},
    "phong 5": {"type": "phong", "exponent": 5},
    "phong 60": {"type": "phong", "exponent": 60, "base_color": 0.1, "specular_color": (0.2, 0.7, 0.3)},
    "conductor .4": {"type": "conductor", "roughness": 0.4},
    "conductor .8 single": {"type": "conductor", "roughness": 0.8, "energy_compensation": False},
    "conductor 1 dark": {"type": "conductor", "roughness": 1.0, "base_color": (0.1, 0.3, 0.9)},
    "anisotropic": {"type": "conductor", "roughness": 0.7, "anisotropy": 0.8, "rotation": 35},
    "plastic smooth": {"type": "plastic", "roughness": 0},
    "plastic .5": {"type": "plastic", "roughness": 0.5},
    "plastic .9": {"type": "plastic", "roughness": 0.9, "base_color": 0.02, "energy_compensation": False},
    "glass .5": {"type": "dielectric", "roughness": 0.5, "energy_compensation": False},
    "glass .6": {"type": "dielectric", "roughness": 0.6},
    "glass 1": {"type": "dielectric", "roughness": 1.0, "ior": 2.4},
    "bubble .7": {"type": "dielectric", "roughness": 0.7, "ior": 0.7},
    "anisotropic glass": {"type": "dielectric", "roughness": 0.8, "anisotropy": 0.7, "rotation": -20},
    "sheet .6": {"type": "thin_dielectric", "roughness": 0.6},
    "paper": {"type": "diffuse_transmission", "reflectance": 0.6, "transmittance": (0.1, 0.3, 0.2)},
}


def _rule(nodes: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, w = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (x + 1.0), 0.5 * w


def _integrate(density: Density, cells: NDArray[np.float64], nodes: int) -> NDArray[np.float64]:
    """Integrals over cells (n, 4) of z, dz, azimuth, its width, by a product Gauss rule."""
    x, w = _rule(nodes)
    z = cells[:, 0, None] + cells[:, 1, None] * x
    phi = cells[:, 2, None] + cells[:, 3, None] * x
    zz, pp = np.broadcast_arrays(z[:, :, None], phi[:, None, :])
    r = np.sqrt(np.maximum(1.0 - zz * zz, 0.0))
    d = np.stack([r * np.cos(pp), r * np.sin(pp), zz], axis=-1).reshape(-1, 3)
    values = density(d).astype(np.float64).reshape(len(cells), -1)
    return np.asarray(values @ np.outer(w, w).ravel() * cells[:, 1] * cells[:, 3])


def _split(cells: NDArray[np.float64], parts: int) -> NDArray[np.float64]:
    """Each cell's parts x parts, in order."""
    i, j = np.meshgrid(np.arange(parts), np.arange(parts), indexing="ij")
    step = cells[:, None, [1, 3]] / parts
    z = cells[:, None, 0] + i.ravel() * step[..., 0]
    phi = cells[:, None, 2] + j.ravel() * step[..., 1]
    rows = np.stack(
        [z, np.broadcast_to(step[..., 0], z.shape), phi, np.broadcast_to(step[..., 1], z.shape)], -1
    )
    return rows.reshape(-1, 4)


def _cell_integrals(density: Density, cells: NDArray[np.float64], depth: int = 3) -> NDArray[np.float64]:
    """Integrals over cells, split where two rules disagree by more than a sample in ten would show."""
    fine, coarse = _integrate(density, cells, 8), _integrate(density, cells, 5)
    unsure = np.abs(fine - coarse) > 0.1 / SAMPLES
    if depth and unsure.any():
        parts = _cell_integrals(density, _split(cells[unsure], 4), depth - 1)
        fine[unsure] = parts.reshape(-1, 16).sum(axis=1)
    return fine


def _sphere_cells() -> NDArray[np.float64]:
    i, j = np.meshgrid(np.arange(HEIGHTS), np.arange(AZIMUTHS), indexing="ij")
    dz, dphi = 2.0 / HEIGHTS, 2.0 * np.pi / AZIMUTHS
    ones = np.ones(i.size)
    return np.stack([-1.0 + i.ravel() * dz, dz * ones, -np.pi + j.ravel() * dphi, dphi * ones], -1)


def _histogram(wi: NDArray[np.float32]) -> NDArray[np.int64]:
    z = np.clip(((wi[:, 2] + 1.0) * 0.5 * HEIGHTS).astype(int), 0, HEIGHTS - 1)
    phi = np.arctan2(wi[:, 1], wi[:, 0])
    column = np.clip(((phi + np.pi) / (2.0 * np.pi) * AZIMUTHS).astype(int), 0, AZIMUTHS - 1)
    return np.bincount(z * AZIMUTHS + column, minlength=HEIGHTS * AZIMUTHS)


def chi2_p(observed: NDArray[Any], expected: NDArray[Any]) -> float:
    """p-value, cells expected to hold fewer than 10 pooled. Both sum to the number of samples."""
    rare = expected < 10.0
    o, e = observed[~rare], expected[~rare]
    pooled_o, pooled_e = observed[rare].sum(), expected[rare].sum()
    statistic = ((o - e) ** 2 / e).sum()
    cells = len(e)
    if pooled_e >= 10.0:
        statistic += (pooled_o - pooled_e) ** 2 / pooled_e
        cells += 1
    else:
        assert pooled_o <= stats.poisson.isf(FALSE_ALARM, max(pooled_e, 1e-3) + 0.5)
    return float(stats.chi2.sf(statistic, max(cells - 1, 1)))


@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.1, 0.01, -0.5])
@pytest.mark.parametrize("name", MATERIALS)
def test_directions_follow_the_stated_density(bench: Any, name: str, cosine: float) -> None:
    material = MATERIALS[name]
    wo = bench.toward(cosine, 0.7)
    s = bench.sample(material, wo, bench.uniforms(SAMPLES, 11))
    inside = _cell_integrals(lambda d: bench.evaluate(material, wo, d)[1], _sphere_cells())
    smooth = s.alive & ~s.delta
    delta = float(s.pdf[s.delta][0]) if s.delta.any() else 0.0
    ended = 1.0 - inside.sum() - delta
    assert ended > -2e-3
    observed = np.concatenate([_histogram(s.wi[smooth]), [s.delta.sum(), (~s.alive).sum()]])
    expected = np.concatenate([inside, [delta, max(ended, 0.0)]])
    expected *= SAMPLES / expected.sum()
    assert chi2_p(observed, expected) > FALSE_ALARM


@pytest.mark.parametrize("cosine", [1.0, 0.3, -0.4])
@pytest.mark.parametrize("name", MATERIALS)
def test_a_sample_agrees_with_evaluating_its_direction(bench: Any, name: str, cosine: float) -> None:
    material = MATERIALS[name]
    wo = bench.toward(cosine, -1.1)
    s = bench.sample(material, wo, bench.uniforms(20_000, 3))
    smooth = s.alive & ~s.delta
    value, pdf = bench.evaluate(material, wo, s.wi[smooth])
    # Grazing directions may round to the other side of the surface, where there is nothing.
    kept = np.abs(s.wi[smooth][:, 2]) > 1e-5
    np.testing.assert_allclose(pdf[kept], s.pdf[smooth][kept], rtol=2e-4)
    product = s.weight[smooth] * s.pdf[smooth][:, None]
    np.testing.assert_allclose(value[kept], product[kept], rtol=2e-4, atol=1e-7)


@pytest.mark.parametrize("exponent", [1e3, 1e6])
def test_narrow_phong_cones_keep_their_shape(bench: Any, exponent: float) -> None:
    # cos^(n + 1) of the angle to the mirror direction is uniform.
    material = {"type": "phong", "base_color": 0, "specular_color": 1, "exponent": exponent}
    wo = np.asarray(bench.toward(0.8, 0.4), np.float32)
    s = bench.sample(material, wo, bench.uniforms(SAMPLES, 5))
    mirror = wo.astype(np.float64) * (-1, -1, 1)
    below = 0.5 * ((s.wi.astype(np.float64) - mirror) ** 2).sum(axis=1)
    u = np.exp((exponent + 1.0) * np.log1p(-below))
    observed = np.histogram(u, bins=64, range=(0.0, 1.0))[0]
    assert observed.sum() == SAMPLES
    assert chi2_p(observed, np.full(64, SAMPLES / 64)) > FALSE_ALARM


WEIGHTS_AT_MOST_ONE = {
    "diffuse": {"type": "diffuse", "base_color": 1},
    "mirror": {"type": "mirror"},
    "metal": {"type": "conductor", "base_color": 1, "roughness": 0.6, "energy_compensation": False},
    "narrow metal": {"type": "conductor", "base_color": 1, "roughness": 0.011, "energy_compensation": False},
    "glass": {"type": "dielectric", "roughness": 0.5, "energy_compensation": False},
    "clear glass": {"type": "dielectric"},
    "sheet": {"type": "thin_dielectric"},
    "paper": {"type": "diffuse_transmission", "reflectance": 0.5, "transmittance": 0.5},
}


@pytest.mark.parametrize("cosine", [1.0, 0.5, 1e-2, 1e-4, 1e-6, -0.5, -1e-3])
@pytest.mark.parametrize("name", WEIGHTS_AT_MOST_ONE)
def test_a_path_never_gains_weight_where_that_is_promised(bench: Any, name: str, cosine: float) -> None:
    material = WEIGHTS_AT_MOST_ONE[name]
    s = bench.sample(material, bench.toward(cosine, 2.0), bench.uniforms(50_000, 7))
    eta2 = 2.25 if material["type"] == "dielectric" else 1.0
    scale = np.where(s.transmitted, eta2 if cosine > 0 else 1.0 / eta2, 1.0)[:, None]
    assert np.isfinite(s.weight[s.alive]).all()
    assert np.isfinite(s.pdf[s.alive]).all()
    assert (s.weight[s.alive] >= 0).all()
    # 16 roundings of quotients that are 1 in exact arithmetic.
    assert (s.weight * scale)[s.alive].max() <= 1.0 + 16 * 2.0**-24


@pytest.mark.parametrize("cosine", [1.0, 0.3, 1e-3, 1e-6, -0.7, -1e-5])
@pytest.mark.parametrize("name", [*MATERIALS, *WEIGHTS_AT_MOST_ONE])
def test_extreme_numbers_and_directions_stay_finite(bench: Any, name: str, cosine: float) -> None:
    material = {**MATERIALS, **WEIGHTS_AT_MOST_ONE}[name]
    ends = np.array([0.0, 2.0**-24, 0.5, 1.0 - 2.0**-24], np.float32)
    u = np.array(np.meshgrid(ends, ends, ends)).reshape(3, -1).T
    wo = bench.toward(cosine, 0.1)
    s = bench.sample(material, wo, u)
    for array in (s.wi, s.weight, s.pdf):
        assert np.isfinite(array[s.alive]).all()
    np.testing.assert_allclose(np.linalg.norm(s.wi[s.alive], axis=1), 1.0, atol=4e-6)
    value, pdf = bench.evaluate(material, wo, bench.directions(2000, 1))
    assert np.isfinite(value).all()
    assert np.isfinite(pdf).all()
    assert (value >= 0).all()
