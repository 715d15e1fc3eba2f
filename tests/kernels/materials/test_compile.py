"""Material models -> records and albedo tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile import albedo
from penumbra_kernels.compile.materials import (
    ALPHA_MIN,
    BLACK_MATERIAL,
    DEFAULT_MATERIAL,
    MaterialError,
    alphas,
    compile_albedo_table,
    compile_materials,
)
from penumbra_kernels.compile.textures import compile_textures
from penumbra_kernels.layout import CONSTANTS
from penumbra_scene import limits
from penumbra_scene.scene import Scene

NONE = CONSTANTS["NONE"]


def compiled(materials: dict[str, Any], textures: dict[str, Any] | None = None) -> Any:
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "perspective"},
            "materials": materials,
            "textures": textures or {},
        }
    )
    _, _, texture_index = compile_textures(scene, NoAssets())
    records, index = compile_materials(scene, texture_index)
    return records, index, compile_albedo_table(records)


def test_shapes_without_a_material_are_gray_and_emitters_black() -> None:
    records, index, table = compiled({})
    assert index == {}
    assert records["type"][DEFAULT_MATERIAL] == CONSTANTS["MATERIAL_DIFFUSE"]
    np.testing.assert_allclose(records["color0"][DEFAULT_MATERIAL], 0.8)
    assert records["type"][BLACK_MATERIAL] == CONSTANTS["MATERIAL_BLACK"]
    assert table.dtype == np.float32


@pytest.mark.parametrize("anisotropy", [0.0, 0.3, 0.9])
def test_anisotropy_keeps_the_mean_square_width(anisotropy: float) -> None:
    # OpenPBR's mapping keeps (alpha_x^2 + alpha_y^2) / 2 = roughness^4, and their ratio is 1 - anisotropy.
    along, across = alphas(0.6, anisotropy)
    assert (along**2 + across**2) / 2 == pytest.approx(0.6**4, rel=1e-6)
    assert across / along == pytest.approx(1 - anisotropy, rel=1e-6)


def test_lobes_below_the_smallest_width_are_mirrors() -> None:
    assert alphas(0.0, 0.0) == (0.0, 0.0)
    assert alphas(0.0099, 0.0) == (0.0, 0.0)
    assert alphas(0.01001, 0.0)[0] >= ALPHA_MIN
    along, across = alphas(0.5, 1.0)
    assert along > 0.3
    assert across == pytest.approx(ALPHA_MIN)


def test_constant_textures_become_colours_and_others_are_named() -> None:
    records, index, _ = compiled(
        {
            "flat": {"type": "diffuse", "base_color": {"texture": "red"}},
            "squares": {"type": "diffuse_transmission", "transmittance": {"texture": "checker"}},
        },
        {"red": {"type": "constant", "color": (1, 0, 0)}, "checker": {"type": "checker"}},
    )
    flat, squares = records[index["flat"]], records[index["squares"]]
    assert flat["texture0"] == NONE
    np.testing.assert_array_equal(flat["color0"], [1, 0, 0])
    assert squares["texture0"] == NONE
    assert squares["texture1"] == 1


def test_rotation_is_in_radians_within_a_turn() -> None:
    metal = {"type": "conductor", "roughness": 0.5, "anisotropy": 0.5}
    records, index, _ = compiled(
        {
            "a": {**metal, "rotation": -90},
            "b": {**metal, "rotation": 765},
            "round": {"type": "conductor", "rotation": 30},
        }
    )
    assert records["rotation"][index["a"]] == pytest.approx(1.5 * np.pi)
    assert records["rotation"][index["b"]] == pytest.approx(0.25 * np.pi, rel=1e-5)
    assert records["rotation"][index["round"]] == 0.0


def test_equal_roughness_shares_one_table() -> None:
    metal = {"type": "conductor", "roughness": 0.5}
    records, index, table = compiled(
        {
            "gold": {**metal, "base_color": (1, 0.8, 0.3)},
            "silver": metal,
            "rough": {"type": "conductor", "roughness": 0.9},
            "plain": {**metal, "energy_compensation": False},
            "mirror": {"type": "conductor", "roughness": 0},
            "glass": {"type": "dielectric", "roughness": 0.5},
        }
    )
    places = {name: int(records["albedo"][i]) for name, i in index.items()}
    assert places["gold"] == places["silver"] != places["rough"]
    assert places["plain"] == places["mirror"] == NONE
    size = albedo.ROWS + albedo.NODES
    assert len(table) == 4 * size
    assert sorted({p for p in places.values() if p != NONE}) == [0, size, 2 * size]


def test_too_many_different_roughnesses_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_ALBEDO_TABLES", 2)
    metals = {str(i): {"type": "conductor", "roughness": 0.3 + 0.1 * i} for i in range(3)}
    with pytest.raises(MaterialError, match=r"/materials: more than 2 .*energy_compensation"):
        compiled(metals)
    compiled({name: {**metal, "energy_compensation": False} for name, metal in metals.items()})


def test_a_nearly_matched_rough_pane_is_clear() -> None:
    records, index, _ = compiled({"m": {"type": "dielectric", "roughness": 0.3, "ior": 1.0005}})
    assert records["alpha_x"][index["m"]] == 0.0


def test_tables_are_finite_whatever_the_roughness() -> None:
    for alpha in np.geomspace(1e-4, 1.4, 13):
        a = float(np.float32(alpha))
        assert np.isfinite(albedo.conductor_table(a, a)).all()
        assert np.isfinite(albedo.heights(a)).all()
        assert albedo.heights(a).max() <= 1.0
        assert np.isfinite(albedo.coat_table(a, a, 1.5, True)).all()
    assert np.isfinite(albedo.dielectric_tables(0.2, 0.1, 1.5)).all()
    assert np.isfinite(albedo.sheet_table(0.2, 1.5)).all()


@pytest.mark.parametrize("alpha", [1e-4, 0.01, 0.2, 1.0])
def test_loss_tables_are_distributions(alpha: float) -> None:
    table = albedo.conductor_table(alpha, alpha)
    cdf = table[albedo.HEADER : albedo.HEADER + albedo.NODES]
    density = table[albedo.HEADER + albedo.NODES : albedo.ROWS][:-1]
    assert cdf[0] == 0.0
    assert cdf[-1] == 1.0
    assert (np.diff(cdf) >= 0).all()
    # Density times the cosine's own measure is the distribution's mass.
    np.testing.assert_allclose(density * np.diff(albedo.heights(table[0]) ** 2), np.diff(cdf), atol=1e-12)


def test_albedo_quadrature_meets_closed_forms() -> None:
    normal = np.array([[0.0, 0.0, 1.0]])
    assert albedo.albedo(normal, 1.0, 1.0, None).reflected[0] == pytest.approx(1 - np.log(2), abs=4e-4)
    # A perfect dielectric at normal incidence reflects ((n - 1) / (n + 1))^2 and passes the rest.
    part = albedo.albedo(normal, 1e-4, 1e-4, 1.5)
    assert part.reflected[0] == pytest.approx(0.04, abs=1e-6)
    assert part.transmitted[0] == pytest.approx(0.96, abs=1e-6)


@pytest.mark.parametrize("eta", [1.2, 1.5, 2.5])
def test_mean_fresnel_obeys_the_reciprocity_of_diffuse_light(eta: float) -> None:
    # 1 - F(1/n) = (1 - F(n)) / n^2: as much diffuse light passes one way as the other.
    inner, outer = albedo.mean_fresnel(1.0 / eta), albedo.mean_fresnel(eta)
    assert 1.0 - inner == pytest.approx((1.0 - outer) / eta**2, abs=1e-7)


def test_mean_fresnel_of_glass() -> None:
    # Diffuse reflectance of index 1.5, 0.09178 (Judd 1942).
    assert albedo.mean_fresnel(1.5) == pytest.approx(0.0918, abs=5e-5)
