"""What a render does not cover is said, and only where it is so."""

from __future__ import annotations

from typing import Any

import pytest
from penumbra_kernels.limits import not_covered
from penumbra_scene.scene import Scene

POINT = [{"type": "point"}]
LAMP = {"type": "sphere", "radius": 0.1, "emission": {"radiance": 1}}
BODILESS, UNMET, LONG = (
    "caustics of lights without a body",
    "caustics of lights that no path has met",
    "light of long paths",
)


def told(
    material: dict[str, Any] | None, max_bounces: int = 65535, used: bool = True, **keys: Any
) -> list[str]:
    shapes = [{"type": "sphere", **({"material": "m"} if used else {})}, *keys.pop("shapes", [])]
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "perspective"},
            "materials": {"m": material or {"type": "diffuse"}},
            "shapes": shapes,
            "integrator": {"max_bounces": max_bounces},
            **keys,
        }
    )
    return [limit.name for limit in not_covered(scene)]


@pytest.mark.parametrize(
    "material",
    [
        {"type": "mirror"},
        {"type": "dielectric"},
        {"type": "thin_dielectric"},
        {"type": "conductor", "roughness": 0.005},
    ],
    ids=lambda m: m["type"],
)
def test_clear_and_mirroring_things_make_caustics(material: dict[str, Any]) -> None:
    assert told(material, lights=POINT) == [BODILESS]
    assert told(material, shapes=[LAMP]) == [UNMET]
    assert told(material, lights=POINT, shapes=[LAMP]) == [BODILESS, UNMET]
    assert told(material, lights=POINT, used=False) == []
    assert told(material) == []


@pytest.mark.parametrize(
    "material",
    [
        {"type": "diffuse"},
        {"type": "plastic", "roughness": 0},
        {"type": "phong"},
        {"type": "dielectric", "roughness": 0.3},
        {"type": "conductor", "roughness": 0.3},
        {"type": "diffuse_transmission"},
    ],
    ids=lambda m: m["type"],
)
def test_what_scatters_can_be_joined_to_lights(material: dict[str, Any]) -> None:
    assert told(material, lights=POINT, shapes=[LAMP]) == []


def test_a_sky_is_met_by_any_path_but_its_image_may_hold_a_sun() -> None:
    assert told({"type": "mirror"}, environment={"type": "constant"}) == []
    image = {"type": "image", "image": {"file": "sky.exr"}}
    assert told({"type": "mirror"}, environment=image) == [UNMET]


def test_ends_of_paths_are_told() -> None:
    assert told(None, max_bounces=8) == [LONG]
