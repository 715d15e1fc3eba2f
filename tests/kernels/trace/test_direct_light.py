"""Direct light against closed forms. A z of 5.3 has a chance of 1e-7."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

ALBEDO = 0.5
Z = 5.3

FLOOR = {"type": "quad", "origin": [-50, 0, 50], "u": [100, 0, 0], "v": [0, 0, -100], "material": "gray"}
MATERIALS = {"gray": {"type": "diffuse", "base_color": ALBEDO}, "black": {"type": "diffuse", "base_color": 0}}
DOWN = {
    "type": "perspective",
    "fov": 0.2,
    "transform": {"look_at": {"origin": [3, 2, 0], "target": [0, 0, 0], "up": [0, 1, 0]}},
}


def scene(**keys: Any) -> dict[str, Any]:
    return {
        "camera": DOWN,
        "film": {"width": 8, "height": 8},
        "materials": MATERIALS,
        "shapes": [FLOOR],
        "integrator": {"max_bounces": 0},
        **keys,
    }


def parallel_quad_form_factor(a: float, b: float, c: float) -> float:
    """From a point to a parallel a x b rectangle at distance c with a corner above the point (Howell, B-3)."""
    x, y = a / c, b / c
    return (
        x / math.sqrt(1 + x * x) * math.atan(y / math.sqrt(1 + x * x))
        + y / math.sqrt(1 + y * y) * math.atan(x / math.sqrt(1 + y * y))
    ) / (2 * math.pi)


@pytest.mark.parametrize("sampling", ["solid_angle", "area"])
@pytest.mark.parametrize("distance", [0.5, 3.0, 40.0])
def test_quad_light_gives_its_form_factor_on_the_floor(render: Any, distance: float, sampling: str) -> None:
    light = {
        "type": "quad",
        "origin": [-0.5, distance, -1],
        "u": [1, 0, 0],
        "v": [0, 0, 2],
        "material": "black",
        "emission": {"radiance": 7},
    }
    picture = render(
        scene(shapes=[FLOOR, light], integrator={"max_bounces": 0, "light_sampling": sampling}), samples=4096
    )
    expected = ALBEDO * 7 * 4 * parallel_quad_form_factor(0.5, 1.0, distance)
    # the picture spans 2 cm of floor: its mean differs from the centre by far less than 1 part in 1000
    assert picture.mean.mean() == pytest.approx(
        expected, rel=1e-3 + Z * np.sqrt(picture.variance.sum()) / picture.mean.size / expected
    )


@pytest.mark.parametrize("ratio", [0.5, 1e-2, 1e-4])
def test_sphere_light_gives_its_irradiance(render: Any, ratio: float) -> None:
    distance = 5.0
    light = {
        "type": "sphere",
        "center": [0, distance, 0],
        "radius": ratio * distance,
        "emission": {"radiance": 1 / ratio**2},
    }
    picture = render(scene(shapes=[FLOOR, light]), samples=4096)
    error = Z * np.sqrt(picture.variance.sum()) / picture.mean.size
    assert picture.mean.mean() == pytest.approx(ALBEDO, rel=1e-3, abs=error)  # albedo/pi * pi L (r/d)^2


def test_point_light_falls_with_the_square(render: Any) -> None:
    picture = render(
        scene(lights=[{"type": "point", "position": [0, 3, 0], "intensity": 9 * math.pi}]), samples=64
    )
    assert picture.mean == pytest.approx(ALBEDO, rel=1e-3)


def test_directional_light_follows_the_cosine(render: Any) -> None:
    light = {"type": "directional", "direction": [math.sqrt(3), -1, 0], "irradiance": math.pi}
    assert render(scene(lights=[light]), samples=16).mean == pytest.approx(ALBEDO / 2, rel=1e-5)


def test_spot_light_is_full_inside_and_dark_outside(render: Any) -> None:
    spot = {
        "type": "spot",
        "position": [0, 3, 0],
        "intensity": 9 * math.pi,
        "inner_cone_angle": 20,
        "outer_cone_angle": 30,
    }
    inside = render(scene(lights=[{**spot, "direction": [0, -1, 0]}]))
    outside = render(scene(lights=[{**spot, "direction": [1, -1, 0]}]))
    assert inside.mean == pytest.approx(ALBEDO, rel=1e-3)
    assert outside.mean.max() == 0


@pytest.mark.parametrize("selection", ["all", "uniform", "power", "tree"])
@pytest.mark.parametrize("picks", [1, 3])
def test_every_choice_of_lights_has_the_same_mean(render: Any, selection: str, picks: int) -> None:
    lights = [
        {"type": "point", "position": [0, h, 0], "intensity": p}
        for h, p in ((2, 1), (3, 30), (5, 0), (4, 0.01))
    ]
    picture = render(
        scene(
            lights=lights, integrator={"max_bounces": 0, "light_selection": selection, "shadow_rays": picks}
        ),
        samples=2048,
    )
    expected = ALBEDO / math.pi * (1 / 4 + 30 / 9 + 0.01 / 16)
    assert picture.mean.mean() == pytest.approx(
        expected, rel=1e-3, abs=Z * np.sqrt(picture.variance.sum()) / picture.mean.size
    )


def test_fixed_light_points_are_the_lectures_sum(render: Any) -> None:
    """regular, one sample, N shadow rays: L A / N sum cos cos' / r^2 over the same N points for every pixel."""
    light = {
        "type": "quad",
        "origin": [-1, 2, -1],
        "u": [2, 0, 0],
        "v": [0, 0, 2],
        "material": "black",
        "emission": {"radiance": 1},
    }
    picture = render(
        scene(
            shapes=[FLOOR, light],
            integrator={"max_bounces": 0, "light_sampling": "area", "shadow_rays": 4},
            sampler={"type": "regular"},
        ),
        samples=1,
        replicates=1,
    )

    def value(p: NDArray[np.float64]) -> float:
        points = [np.array([x, 2.0, z]) for x in (-0.5, 0.5) for z in (-0.5, 0.5)]
        return sum(4 / 4 * (2 / np.linalg.norm(q - p)) ** 2 / np.linalg.norm(q - p) ** 2 for q in points)

    expected = ALBEDO / math.pi * value(np.zeros(3))
    assert picture.mean.mean() == pytest.approx(expected, rel=3e-3)


def hall(**integrator: Any) -> dict[str, Any]:
    """Lamps of all kinds and powers about a glossy floor, two glass balls and a sheet of paper, under a dim sky."""
    rng = np.random.default_rng(8)
    lamps = []
    for i, (x, y, z) in enumerate(rng.uniform([-3, 0.5, -3], [3, 2.5, 3], (24, 3)).round(3).tolist()):
        glow = {"radiance": float(10 ** rng.uniform(-1, 1.3)), "two_sided": i % 6 == 0}
        if i % 3 == 0:
            lamps.append(
                {"type": "quad", "origin": [x, y, z], "u": [0.3, 0.1, 0], "v": [0, 0, 0.3], "emission": glow}
            )
        elif i % 3 == 1:
            lamps.append({"type": "sphere", "center": [x, y, z], "radius": 0.1, "emission": glow})
        else:
            lamps.append(
                {"type": "disc", "center": [x, y, z], "normal": [x, y, 1], "radius": 0.2, "emission": glow}
            )
    spot = {"type": "spot", "position": [0, 3, 0], "direction": [0.2, -1, 0], "intensity": 5}
    return {
        "camera": {
            "type": "perspective",
            "fov": 50,
            "transform": {"look_at": {"origin": [0, 2, 7], "target": [0, 0.8, 0]}},
        },
        "film": {"width": 12, "height": 12},
        "materials": {
            "floor": {"type": "plastic", "base_color": 0.5, "roughness": 0.4},
            "glass": {"type": "dielectric", "roughness": 0.3},
            "paper": {"type": "diffuse_transmission", "reflectance": 0.4, "transmittance": 0.4},
        },
        "shapes": [
            {"type": "plane", "material": "floor"},
            {"type": "sphere", "center": [-1, 0.7, 1], "radius": 0.7, "material": "glass"},
            {"type": "quad", "origin": [0.5, 0, 1], "u": [1, 0, 0.5], "v": [0, 1, 0], "material": "paper"},
            *lamps,
        ],
        "lights": [spot, {"type": "directional", "direction": [1, -2, 0], "irradiance": 0.2}],
        "environment": {"type": "constant", "radiance": 0.1},
        "integrator": {"max_bounces": 3, **integrator},
    }


@pytest.mark.parametrize(
    "integrator",
    [
        {"light_selection": "uniform"},
        {"light_selection": "power"},
        {"light_selection": "tree"},
        {"light_selection": "tree", "shadow_rays": 3},
        {"light_selection": "tree", "light_sampling": "area"},
    ],
    ids=["uniform", "power", "tree", "tree, three rays", "tree, by area"],
)
def test_pictures_agree_whichever_way_lights_are_chosen(render: Any, integrator: dict[str, Any]) -> None:
    """Against every light asked at every hit: the tree's probabilities also weigh the emitters that lobes meet."""
    truth = render(hall(light_selection="all"), samples=1024)
    picture = render(hall(**integrator), samples=2048)
    error = np.sqrt(picture.variance.sum() + truth.variance.sum()) / truth.mean.size
    assert abs(picture.mean.mean() - truth.mean.mean()) < Z * error
    assert error < 0.02 * truth.mean.mean()
