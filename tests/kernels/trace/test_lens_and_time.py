"""Depth of field, motion blur, aliasing: closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

Z = 5.3


def dark(**keys: Any) -> dict[str, Any]:
    return {
        "materials": {"black": {"type": "diffuse", "base_color": 0}},
        "integrator": {"max_bounces": 0},
        **keys,
    }


@pytest.mark.parametrize("blades", [0, 6])
@pytest.mark.parametrize("depth", [1.5, 8.0])
def test_a_point_out_of_focus_spreads_over_its_circle_of_confusion(
    render: Any, depth: float, blades: int
) -> None:
    """Thin lens: a point at depth z blurs to a disc of radius a |1/z - 1/f| in the plane z = 1; second moments tell it.

    A regular n-gon of circumradius r has the second moment r^2 (2 + cos(2 pi / n)) / 12 along an axis."""
    aperture, focus, radius, side = 0.1, 3.0, 0.01 * depth, 64
    fov = 10.0
    picture = render(
        dark(
            camera={
                "type": "perspective",
                "fov": fov,
                "lens": {"aperture_radius": aperture, "focus_distance": focus, "blades": blades},
            },
            film={"width": side, "height": side},
            shapes=[
                {
                    "type": "disc",
                    "center": [0, 0, -depth],
                    "radius": radius,
                    "material": "black",
                    "emission": {"radiance": 1},
                }
            ],
        ),
        samples=1024,
    )
    pixel = 2 * math.tan(math.radians(fov / 2)) / side
    x = (np.arange(side) - side / 2 + 0.5) * pixel
    weights = picture.mean[..., 0]
    blur = aperture * abs(1 / depth - 1 / focus)
    shape = 0.25 if blades == 0 else (2 + math.cos(2 * math.pi / blades)) / 12
    expected = shape * blur**2 + (radius / depth) ** 2 / 4 + pixel**2 / 12
    for axis in (0, 1):
        profile = weights.sum(axis=axis)
        assert (profile * x**2).sum() / profile.sum() == pytest.approx(expected, rel=0.02)
    # energy: the disc covers the same solid angle, focused or not
    assert weights.sum() * pixel**2 == pytest.approx(math.pi * (radius / depth) ** 2, rel=0.02)


@pytest.mark.parametrize("what", ["shape", "camera"])
def test_a_moving_disc_covers_each_pixel_for_its_share_of_time(render: Any, what: str) -> None:
    width, height, radius, speed = 32, 8, 0.3, 1.0

    def motion(sign: float) -> dict[str, Any]:
        return {
            "keyframes": [
                {"time": t, "transform": [{"translate": [sign * speed * (t - 0.5), 0, 0]}]}
                for t in (0.0, 1.0)
            ]
        }

    picture = render(
        dark(
            camera={
                "type": "orthographic",
                "height": 0.5,
                "shutter": {"open": 0, "close": 1},
                **({"transform": motion(-1)} if what == "camera" else {}),
            },
            film={"width": width, "height": height},
            shapes=[
                {
                    "type": "disc",
                    "center": [0, 0, -1],
                    "radius": radius,
                    "material": "black",
                    "emission": {"radiance": 1},
                    **({"transform": motion(1)} if what == "shape" else {}),
                }
            ],
        ),
        samples=2048,
    )
    pixel = 0.5 / height
    sub = 8
    x = (np.arange(width * sub) + 0.5) / sub * pixel - width * pixel / 2
    y = (np.arange(height * sub) + 0.5) / sub * pixel - height * pixel / 2
    times = (np.arange(512) + 0.5) / 512 - 0.5
    inside = (x[None, None] - speed * times[:, None, None]) ** 2 + y[None, :, None] ** 2 < radius**2
    expected = inside.mean(axis=0).reshape(height, sub, width, sub).mean(axis=(1, 3))
    assert np.abs(picture.mean[..., 0] - expected).max() < 0.04
    assert abs(picture.z_of(expected.mean())) < Z or picture.mean[..., 0].mean() == pytest.approx(
        expected.mean(), abs=5e-4
    )


def test_a_shutter_without_duration_is_the_still_picture(render: Any) -> None:
    def scene(**keys: Any) -> dict[str, Any]:
        return dark(
            camera={"type": "perspective", **keys},
            film={"width": 16, "height": 16},
            shapes=[
                {"type": "sphere", "center": [0, 0, -3], "material": "black", "emission": {"radiance": 1}},
            ],
        )

    still = render(scene(), samples=16)
    shut = render(scene(shutter={"open": 0.0, "close": 0.0}), samples=16)
    assert still.node.sums.tobytes() == shut.node.sums.tobytes()


def test_a_checkerboard_at_the_horizon_has_its_mean(render: Any) -> None:
    picture = render(
        {
            "camera": {
                "type": "perspective",
                "fov": 1,
                "transform": {"look_at": {"origin": [0, 1, 0], "target": [0.3, 0.4, -40]}},
            },
            "film": {"width": 16, "height": 16},
            "textures": {"c": {"type": "checker", "color0": 0, "color1": 1}},
            "materials": {"m": {"type": "diffuse", "base_color": {"texture": "c"}}},
            "shapes": [{"type": "plane", "material": "m"}],
            "environment": {"type": "constant", "radiance": 1},
            "integrator": {"max_bounces": 0},
        },
        samples=1024,
    )
    # 16 x 16 pixels span hundreds of squares
    assert abs(picture.mean.mean() - 0.5) < 0.01 + Z * np.sqrt(picture.variance.sum()) / picture.mean.size


def test_regular_sampling_aliases_where_jitter_makes_noise(render: Any) -> None:
    """One regular sample a pixel answers 0 or 1 everywhere; the same for every seed."""

    def board(sampler: str, seed: int) -> Any:
        return render(
            {
                "camera": {
                    "type": "perspective",
                    "fov": 30,
                    "transform": {"look_at": {"origin": [0, 1, 0], "target": [0, 0.5, -10]}},
                },
                "film": {"width": 32, "height": 16},
                "textures": {"c": {"type": "checker", "color0": 0, "color1": 1}},
                "materials": {"m": {"type": "diffuse", "base_color": {"texture": "c"}}},
                "shapes": [{"type": "plane", "material": "m"}],
                "lights": [{"type": "directional", "irradiance": math.pi}],
                "integrator": {"max_bounces": 0},
                "sampler": {"type": sampler, "seed": seed},
            },
            samples=1,
            replicates=1,
        ).mean

    regular = board("regular", 1)
    assert (regular == board("regular", 2)).all()
    assert not (board("jittered", 1) == board("jittered", 2)).all()
    assert set(np.unique(np.round(regular, 4))) <= {0.0, 1.0}
