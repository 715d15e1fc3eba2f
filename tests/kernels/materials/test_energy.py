"""What surfaces owe to physics: furnaces, reciprocity, energy, slabs and sheets, sides of the normals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.hardcases.benches.materials import RECIPROCAL, TILTED, albedo_of

SIGMAS = 5.0
"""A false alarm in two million; the means below are of bounded numbers, so nearly normal."""
SAMPLES = 100_000


def _roughness(alpha: float) -> float:
    return float(np.sqrt(alpha))


METALS = [(a, c) for a in (1e-3, 0.01, 0.1, 0.3, 0.7, 1.0) for c in (1.0, 0.7, 0.3, 0.1, 0.03, 1e-3)]


@pytest.mark.parametrize(("alpha", "cosine"), METALS)
def test_compensated_metal_is_white_in_a_furnace(bench: Any, alpha: float, cosine: float) -> None:
    material = {"type": "conductor", "base_color": 1, "roughness": _roughness(alpha)}
    mean, error = albedo_of(bench, material, cosine)
    assert mean == pytest.approx(1.0, abs=SIGMAS * error + 0.005)


@pytest.mark.parametrize("azimuth", [0.0, 0.5, 1.0, np.pi / 2])
@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1])
@pytest.mark.parametrize("anisotropy", [0.5, 1.0])
def test_compensated_anisotropic_metal_is_white_in_a_furnace(
    bench: Any, anisotropy: float, cosine: float, azimuth: float
) -> None:
    material = {"type": "conductor", "base_color": 1, "roughness": 0.8, "anisotropy": anisotropy}
    s = bench.sample(material, bench.toward(cosine, azimuth), bench.uniforms(SAMPLES, 29))
    energy = np.where(s.alive, s.weight[:, 0].astype(np.float64), 0.0)
    assert energy.mean() == pytest.approx(1.0, abs=SIGMAS * energy.std() / np.sqrt(SAMPLES) + 0.01)


@pytest.mark.parametrize("cosine", [1.0, 0.2, 0.02, -1.0, -0.5, -0.1])
@pytest.mark.parametrize("ior", [0.7, 1.5, 2.4])
@pytest.mark.parametrize("alpha", [0.05, 0.4, 1.0])
def test_compensated_glass_keeps_all_light(bench: Any, alpha: float, ior: float, cosine: float) -> None:
    material = {"type": "dielectric", "roughness": _roughness(alpha), "ior": ior}
    mean, error = albedo_of(bench, material, cosine, ior if cosine > 0 else 1.0 / ior)
    assert mean == pytest.approx(1.0, abs=SIGMAS * error + 0.01)


WHITE: dict[str, tuple[dict[str, Any], float]] = {
    # A white material, and how far from 1 its tables may leave it.
    "diffuse": ({"type": "diffuse", "base_color": 1}, 1e-6),
    "mirror": ({"type": "mirror"}, 1e-6),
    "smooth metal": ({"type": "conductor", "base_color": 1, "roughness": 0}, 1e-6),
    "smooth plastic": ({"type": "plastic", "base_color": 1, "roughness": 0}, 1e-4),
    "smooth plastic, dense": ({"type": "plastic", "base_color": 1, "roughness": 0, "ior": 3}, 1e-4),
    "plastic .1": ({"type": "plastic", "base_color": 1, "roughness": 0.1}, 0.005),
    "plastic .5": ({"type": "plastic", "base_color": 1, "roughness": 0.5}, 0.005),
    "plastic 1": ({"type": "plastic", "base_color": 1, "roughness": 1, "ior": 2}, 0.005),
    "sheet": ({"type": "thin_dielectric"}, 1e-6),
    "sheet .5": ({"type": "thin_dielectric", "roughness": 0.5}, 0.005),
    "sheet 1": ({"type": "thin_dielectric", "roughness": 1}, 0.005),
    "paper": ({"type": "diffuse_transmission", "reflectance": 0.25, "transmittance": 0.75}, 1e-6),
}


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1, 0.01, -0.3])
@pytest.mark.parametrize("name", WHITE)
def test_white_materials_are_white_in_a_furnace(bench: Any, name: str, cosine: float) -> None:
    material, tolerance = WHITE[name]
    mean, error = albedo_of(bench, material, cosine)
    assert mean == pytest.approx(1.0, abs=SIGMAS * error + tolerance)


NO_GAIN: dict[str, dict[str, Any]] = {
    "phong 0": {"type": "phong", "base_color": 0.4, "specular_color": 0.6, "exponent": 0},
    "phong, asking for more": {"type": "phong", "base_color": 0.8, "specular_color": 0.9, "exponent": 9},
    "phong 20": {"type": "phong", "base_color": 0, "specular_color": 1, "exponent": 20},
    "metal": {"type": "conductor", "base_color": 0.9, "roughness": 0.9},
    "metal, constant": {"type": "conductor", "base_color": 0.9, "roughness": 0.9, "fresnel": False},
    "plastic": {"type": "plastic", "base_color": 0.9, "roughness": 0.7, "energy_compensation": False},
    "tinted glass": {"type": "dielectric", "roughness": 0.6, "color": 0.9},
    "paper": {"type": "diffuse_transmission", "reflectance": 0.4, "transmittance": 0.4},
}


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1, 0.001, -0.4])
@pytest.mark.parametrize("name", NO_GAIN)
def test_no_material_makes_light(bench: Any, name: str, cosine: float) -> None:
    ior = 1.0 if name != "tinted glass" else (1.5 if cosine > 0 else 1 / 1.5)
    mean, error = albedo_of(bench, NO_GAIN[name], cosine, ior)
    assert mean <= 1.0 + SIGMAS * error + 1e-6


def test_phong_reflects_its_specular_color_at_normal_incidence(bench: Any) -> None:
    # The integral of (n + 2) / (2 pi) cos^n cos over the hemisphere is 1.
    material = {"type": "phong", "base_color": 0.2, "specular_color": 0.5, "exponent": 40}
    mean, error = albedo_of(bench, material, 1.0)
    assert mean == pytest.approx(0.7, abs=SIGMAS * error)


@pytest.mark.parametrize("name", RECIPROCAL)
def test_no_light_leaks_through_a_bent_normal(bench: Any, name: str) -> None:
    material = RECIPROCAL[name]
    wo = bench.directions(50_000, 6)
    s = bench.sample(material, wo, bench.uniforms(len(wo), 7), TILTED)
    below = wo[:, 2] * s.wi[:, 2] < 0
    np.testing.assert_array_equal(below[s.alive], s.transmitted[s.alive])
    passes = material["type"] in ("dielectric", "thin_dielectric", "diffuse_transmission")
    assert passes or not below[s.alive].any()
    wi = bench.directions(50_000, 8)
    value, pdf = bench.evaluate(material, wo, wi, TILTED)
    shading = (wo @ np.float32(TILTED[1])) * (wi @ np.float32(TILTED[1]))
    geometric = wo[:, 2] * wi[:, 2]
    torn = (shading * geometric < 0) & (np.minimum(abs(shading), abs(geometric)) > 1e-6)
    assert torn.sum() > 1000
    assert not value[torn].any()
    assert not pdf[torn].any()


@pytest.mark.parametrize("name", ["diffuse", "metal", "plastic", "phong"])
def test_opaque_materials_look_alike_from_both_sides(bench: Any, name: str) -> None:
    wo, wi = bench.directions(5000, 9), bench.directions(5000, 10)
    flipped = np.array([1, 1, -1], np.float32)
    front, _ = bench.evaluate(
        {**RECIPROCAL[name], "rotation": 0} if name == "metal" else RECIPROCAL[name], wo, wi
    )
    back, _ = bench.evaluate(
        {**RECIPROCAL[name], "rotation": 0} if name == "metal" else RECIPROCAL[name],
        wo * flipped,
        wi * flipped,
    )
    np.testing.assert_allclose(front, back, rtol=1e-6)


def test_rotation_turns_the_highlight(bench: Any) -> None:
    # Turning the tangent by 30 degrees is turning both directions back by 30 degrees, from either side.
    metal = {"type": "conductor", "roughness": 0.6, "anisotropy": 0.7}
    a = np.radians(30.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    wo, wi = bench.directions(5000, 11), bench.directions(5000, 12)
    turned, _ = bench.evaluate({**metal, "rotation": 30}, wo @ turn.T, wi @ turn.T)
    plain, _ = bench.evaluate(metal, wo, wi)
    assert plain.max() > 1
    np.testing.assert_allclose(turned, plain, rtol=1e-3, atol=1e-5)


SMOOTH = [
    ({"type": "diffuse"}, True),
    ({"type": "phong"}, True),
    ({"type": "mirror"}, False),
    ({"type": "conductor", "roughness": 0}, False),
    ({"type": "conductor", "roughness": 0.009}, False),
    ({"type": "conductor", "roughness": 0.011}, True),
    ({"type": "plastic", "roughness": 0}, True),
    ({"type": "dielectric"}, False),
    ({"type": "dielectric", "roughness": 0.3}, True),
    ({"type": "thin_dielectric"}, False),
    ({"type": "thin_dielectric", "roughness": 0.3}, True),
    ({"type": "diffuse_transmission"}, True),
]


@pytest.mark.parametrize(("material", "smooth"), SMOOTH)
def test_only_materials_with_a_smooth_lobe_ask_for_light_samples(
    bench: Any, material: Any, smooth: bool
) -> None:
    directions = bench.directions(500, 3)
    albedo, has = bench.describe(material, directions)
    assert has.all() == smooth
    assert has.any() == smooth
    value, _ = bench.evaluate(material, directions, bench.directions(500, 4))
    assert value.any() == smooth
    assert (albedo >= 0).all()
    assert (albedo <= 1.0 + 1e-6).all()


def test_a_viewer_behind_the_shading_normal_meets_delta_lobes_only(bench: Any) -> None:
    wo = bench.toward(0.1, np.pi)  # above the geometric normal, behind the tilted one
    _, smooth = bench.describe({"type": "diffuse"}, wo, TILTED)
    assert not smooth.any()
    assert not bench.sample({"type": "diffuse"}, wo, bench.uniforms(100, 1), TILTED).alive.any()
    s = bench.sample({"type": "mirror"}, wo, bench.uniforms(1, 1), TILTED)
    np.testing.assert_allclose(s.wi[0], bench.toward(0.1, 0.0), atol=1e-6)
