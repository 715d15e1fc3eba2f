"""Energy: furnaces, closed rooms, slabs. Truth is known without another renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

Z = 5.3
ENVIRONMENT = {"type": "constant", "radiance": 1}


def furnace(material: dict[str, Any], **keys: Any) -> dict[str, Any]:
    return {
        "camera": {"type": "perspective", "fov": 40, "transform": {"translate": [0, 0, 4]}},
        "film": {"width": 16, "height": 16},
        "materials": {"m": material},
        "shapes": [{"type": "sphere", "material": "m"}],
        "environment": ENVIRONMENT,
        "integrator": {"max_bounces": 64},
        **keys,
    }


@pytest.mark.parametrize("start", [0, 3])
def test_roulette_keeps_the_mean_of_every_colour(render: Any, start: int) -> None:
    """L = Le / (1 - albedo) in each channel. Survival goes by the brightest one: the others must not gain or lose."""
    albedo = np.array([0.9, 0.5, 0.1])
    scene = {
        "camera": {"type": "perspective", "fov": 60},
        "film": {"width": 8, "height": 8},
        "materials": {"m": {"type": "diffuse", "base_color": albedo.tolist()}},
        "shapes": [
            {"type": "sphere", "radius": 2, "material": "m", "emission": {"radiance": 1, "two_sided": True}}
        ],
        "integrator": {"max_bounces": 65535, "roulette_start": start},
    }
    picture = render(scene, samples=2048)
    error = np.sqrt(picture.variance.sum(axis=(0, 1))) / 64
    assert (np.abs(picture.mean.mean(axis=(0, 1)) - 1 / (1 - albedo)) < Z * error).all()
    assert (error < 0.005 / (1 - albedo)).all()


@pytest.mark.parametrize(
    "material",
    [
        {"type": "conductor", "base_color": 1, "fresnel": False, "roughness": 0.2},
        {"type": "dielectric", "roughness": 0.3},
    ],
    ids=lambda m: m["type"],
)
@pytest.mark.parametrize("program", ["generic", "specialised"])
def test_no_sample_of_a_narrow_lobe_at_the_last_hit_is_bright(
    render: Any, material: dict[str, Any], program: str
) -> None:
    """A lobe's own ray brings G2 / G1 <= 1 of a light of radiance 1, or less through glass from outside. Its share by the
    power heuristic leaves a light sample f p / (p^2 + q^2) <= f / (2 q) <= 1/2, so that no path exceeds 3/2. Light samples
    alone would now and then hit the peak of the lobe: with the sky's p = 1 / (4 pi), f / p reaches hundreds."""
    scene = furnace({**material, "energy_compensation": False}, integrator={"max_bounces": 0})
    picture = render(scene, samples=64, replicates=64, program=program)
    paths = picture.node.sums["rgba"][..., :3]
    assert paths.max() <= 1.5 * (1 + 1e-5)
    assert paths.max() > 1.01  # both kinds of sample are there


@pytest.mark.parametrize("bounces", [0, 1])
def test_a_diffuse_floor_under_a_constant_sky_has_no_noise(render: Any, bounces: int) -> None:
    """f times radiance over the density of a light sample is the albedo, whatever the sample, and so is a lobe's own ray."""
    floor = {"type": "plane", "point": [0, -1, 0], "normal": [0, 1, 0], "material": "m"}
    camera = {
        "type": "perspective",
        "fov": 40,
        "transform": {"look_at": {"origin": [0, 3, 0], "target": [1, -1, 0]}},
    }
    scene = furnace(
        {"type": "diffuse", "base_color": 0.7},
        camera=camera,
        shapes=[floor],
        integrator={"max_bounces": bounces},
    )
    picture = render(scene, samples=64, replicates=64)
    assert picture.node.sums["rgba"][..., :3] == pytest.approx(0.7, rel=1e-5)


def test_an_empty_scene_shows_its_environment_exactly(render: Any) -> None:
    picture = render(furnace({"type": "diffuse"}, shapes=[]), samples=8)
    assert (picture.mean == 1).all()
    assert (picture.alpha == 0).all()
