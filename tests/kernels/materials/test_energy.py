"""What surfaces owe to physics: furnaces, reciprocity, energy, slabs and sheets, sides of the normals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

SIGMAS = 5.0
"""A false alarm in two million; the means below are of bounded numbers, so nearly normal."""
SAMPLES = 100_000

TILTED = ((0.0, 0.0, 1.0), (0.28, 0.0, 0.96), (0.96, 0.0, -0.28))
"""A shading normal 16 degrees off the geometric one."""


def _roughness(alpha: float) -> float:
    return float(np.sqrt(alpha))


def albedo_of(bench: Any, material: dict[str, Any], cosine: float, eta: float = 1.0) -> tuple[float, float]:
    """Mean energy that leaves, first channel, and its standard error. eta: far index over near index; what is
    transmitted is radiance there times eta^2."""
    s = bench.sample(material, bench.toward(cosine, 0.9), bench.uniforms(SAMPLES, 23))
    energy = np.where(s.alive, s.weight[:, 0].astype(np.float64), 0.0)
    energy *= np.where(s.transmitted, eta * eta, 1.0)
    return float(energy.mean()), float(energy.std() / np.sqrt(SAMPLES))


@pytest.mark.parametrize(
    ("alpha", "cosine", "expected"), [(1.0, 1.0, 0.30685), (0.5, 1.0, 0.6877), (0.1, 0.1, 0.8834)]
)
def test_single_scattering_loses_what_it_must(
    bench: Any, alpha: float, cosine: float, expected: float
) -> None:
    # At alpha 1 and normal incidence the mean of G2 / G1 over the visible normals is 1 - ln 2.
    material = {
        "type": "conductor",
        "base_color": 1,
        "roughness": _roughness(alpha),
        "energy_compensation": False,
    }
    mean, error = albedo_of(bench, material, cosine)
    assert mean == pytest.approx(expected, abs=SIGMAS * error + 5e-5)


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


RECIPROCAL: dict[str, dict[str, Any]] = {
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


def _function(
    bench: Any, material: Any, frame: Any, wo: NDArray[Any], wi: NDArray[Any]
) -> NDArray[np.float64]:
    """f, without the cosine, divided by the square of the index on the side of wo (Veach 1997, eq. 5.14)."""
    value, _ = bench.evaluate(material, wo, wi, frame)
    cosine = np.abs(wi.astype(np.float64) @ np.asarray(frame[1]))
    index = np.where(wo.astype(np.float64) @ np.asarray(frame[0]) < 0, material.get("ior", 1.5), 1.0)
    if material["type"] != "dielectric":
        index = np.ones(len(wi))
    return np.asarray(value / (cosine * index**2)[:, None])


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("name", RECIPROCAL)
def test_light_goes_both_ways_alike(bench: Any, name: str, tilted: bool) -> None:
    frame = TILTED if tilted else bench.FLAT
    wo, wi = bench.directions(100_000, 1), bench.directions(100_000, 2)
    # Cosines carry absolute errors of some 2^-23: beyond a hundredth they are good to 1e-5.
    clear = (np.abs(wo @ np.asarray(frame[1])) > 0.02) & (np.abs(wi @ np.asarray(frame[1])) > 0.02)
    wo, wi = wo[clear], wi[clear]
    there = _function(bench, RECIPROCAL[name], frame, wo, wi)
    back = _function(bench, RECIPROCAL[name], frame, wi, wo)
    assert (there > 0).mean() > 0.05
    np.testing.assert_allclose(there, back, rtol=1e-4, atol=1e-5)
    # Nearly all pairs agree to 1e-5; those on the flank of a narrow refracted lobe amplify their rounding.
    agree = np.abs(there - back) <= 1e-5 * np.maximum(np.abs(there), 1.0)
    assert agree.mean() > 0.999


def test_a_thin_sheet_passes_the_sum_of_its_reflections(bench: Any) -> None:
    s = bench.sample({"type": "thin_dielectric", "ior": 1.5}, (0.0, 0.0, 1.0), bench.uniforms(1000, 1))
    assert s.pdf[s.transmitted] == pytest.approx(0.96 / 1.04, abs=1e-6)
    assert s.pdf[~s.transmitted] == pytest.approx(0.08 / 1.04, abs=1e-6)
    np.testing.assert_array_equal(s.weight, 1.0)
    np.testing.assert_array_equal(s.wi[:, :2], 0.0)
    np.testing.assert_array_equal(s.wi[:, 2], np.where(s.transmitted, -1.0, 1.0))


def test_a_slab_of_glass_passes_the_sum_of_its_reflections(bench: Any) -> None:
    # Two faces of reflectance .04 in series, rays followed between them: T = (1 - R) / (1 + R).
    rng = np.random.default_rng(8)
    through, n = 0, 100_000
    s = bench.sample({"type": "dielectric"}, (0.0, 0.0, 1.0), rng.random((n, 3)))
    inside = np.count_nonzero(s.transmitted)
    weight = float(s.weight[s.transmitted][0, 0])
    for bounce in range(12):
        s = bench.sample({"type": "dielectric"}, (0.0, 0.0, -1.0), rng.random((inside, 3)))
        out = np.count_nonzero(s.transmitted)
        assert s.weight[s.transmitted][0, 0] * weight == pytest.approx(1.0, abs=1e-6)
        through += out if bounce % 2 == 0 else 0
        inside -= out
        if inside == 0:
            break
    expected = 0.96 / 1.04
    assert through / n == pytest.approx(expected, abs=SIGMAS * np.sqrt(expected * (1 - expected) / n))


@pytest.mark.parametrize("roughness", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["dielectric", "thin_dielectric"])
def test_matched_index_is_invisible(bench: Any, kind: str, roughness: float) -> None:
    material = {"type": kind, "ior": 1.0, "roughness": roughness if kind == "dielectric" else 0.0}
    wo = bench.directions(20_000, 4)
    for frame in (bench.FLAT, TILTED):
        s = bench.sample(material, wo, bench.uniforms(len(wo), 5), frame)
        np.testing.assert_array_equal(s.wi, -wo)
        np.testing.assert_array_equal(s.weight, 1.0)
        np.testing.assert_array_equal(s.pdf, 1.0)


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
