"""Claims about cameras: projections, the lens, the shutter, motion; against float64 and closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.compile.transforms import matrix_at
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.camera import Cameras, camera_of, random_u
from penumbra_scene.film import Film
from scipy.stats import chi2

FALSE_ALARM = 1e-6

Shoot = Cameras
LOOK = {"look_at": {"origin": [1.0, 2.0, 5.0], "target": [0.5, 1.0, -2.0]}}


@pytest.fixture(scope="session")
def shoot(device: Device) -> Shoot:
    return Cameras(device)


def test_pinhole_rays_are_those_of_float64(shoot: Shoot) -> None:
    u = random_u()
    film = Film(width=320, height=200)
    camera = camera_of(transform=LOOK, fov=60)
    o, d, time = shoot(camera, u, film)
    m = matrix_at(camera.transform, 0.0)
    half = math.tan(math.radians(30))
    x, y = (2 * u[:, 0].astype(float) - 1) * half * 1.6, (1 - 2 * u[:, 1].astype(float)) * half
    expected = np.stack([x, y, -np.ones_like(x)], axis=1) @ m[:3, :3].T
    np.testing.assert_allclose(d, expected, atol=1e-6)
    np.testing.assert_allclose(o, np.broadcast_to(m[:3, 3], o.shape), rtol=1e-7)
    np.testing.assert_array_equal(time, 0.0)


def test_up_in_the_world_is_up_in_the_picture_and_right_is_right(shoot: Shoot) -> None:
    u = np.float32([[0.5, 0.5, 0.5, 0.5, 0], [0.5, 0, 0.5, 0.5, 0], [1, 0.5, 0.5, 0.5, 0]])
    _, d, _ = shoot(camera_of(), u)
    np.testing.assert_array_equal(d[0], [0, 0, -1])
    assert d[1, 1] > 0
    assert d[2, 0] > 0


@pytest.mark.parametrize(
    ("axis", "width", "height", "horizontal"),
    [
        ("x", 100, 50, True),
        ("x", 50, 100, True),
        ("y", 100, 50, False),
        ("y", 50, 100, False),
        ("larger", 100, 50, True),
        ("larger", 50, 100, False),
        ("smaller", 100, 50, False),
        ("smaller", 50, 100, True),
    ],
)
def test_field_of_view_is_along_its_axis(
    shoot: Shoot, axis: str, width: int, height: int, horizontal: bool
) -> None:
    edges = np.float32([[1, 0.5, 0.5, 0.5, 0], [0.5, 0, 0.5, 0.5, 0]])
    _, d, _ = shoot(camera_of(fov=50, fov_axis=axis), edges, Film(width=width, height=height))
    right, top = d[0, 0], d[1, 1]
    assert (right if horizontal else top) == pytest.approx(math.tan(math.radians(25)), rel=1e-6)
    assert right / top == pytest.approx(width / height, rel=1e-6)


def test_orthographic_rays_are_parallel_and_span_the_height(shoot: Shoot) -> None:
    u = random_u()
    camera = camera_of(type="orthographic", height=3.0, transform=LOOK)
    o, d, _ = shoot(camera, u, Film(width=200, height=100))
    m = matrix_at(camera.transform, 0.0)
    np.testing.assert_allclose(d, np.broadcast_to(-m[:3, 2], d.shape), atol=1e-7)
    local = (o - m[:3, 3]) @ m[:3, :3]
    np.testing.assert_allclose(local[:, 0], (2 * u[:, 0] - 1) * 3.0, atol=2e-6)
    np.testing.assert_allclose(local[:, 1], (1 - 2 * u[:, 1]) * 1.5, atol=2e-6)


@pytest.mark.parametrize("blades", [0, 5])
def test_circle_of_confusion(shoot: Shoot, blades: int) -> None:
    """All rays of one film point meet in the plane in focus; at depth z they fill a disc or polygon of radius
    a |z - f| / f, uniformly."""
    aperture, focus = 0.2, 4.0
    u = random_u(1 << 16)
    u[:, 0], u[:, 1] = 0.7, 0.2
    lens = {"aperture_radius": aperture, "focus_distance": focus, "blades": blades, "rotation": 20}
    o, d, _ = shoot(camera_of(fov=90, lens=lens), u)
    at_focus = o + focus * d
    assert np.abs(at_focus - at_focus[0]).max() < 1e-5
    assert at_focus[0, 2] == pytest.approx(-focus)
    for z in (1.0, 2.5, 9.0):
        spot = (o + z * d)[:, :2] - np.array([0.4, 0.6]) * z
        radius = aperture * abs(z - focus) / focus
        assert np.hypot(*spot.T).max() == pytest.approx(radius, rel=0.02)
        # Second moment about the axis: r^2 / 2 for a disc, r^2 (2 + cos(2 pi / n)) / 6 for a regular polygon.
        moment = 0.5 if blades == 0 else (2 + math.cos(2 * math.pi / blades)) / 6
        assert (spot**2).sum(axis=1).mean() == pytest.approx(moment * radius**2, rel=0.01)


@pytest.mark.parametrize("curve", [(1, 1), (0, 1, 1, 0), (1, 0, 0, 4), (0.0, 2.0)])
def test_times_follow_the_shutters_curve(shoot: Shoot, curve: tuple[float, ...]) -> None:
    cells = 48
    camera = camera_of(shutter={"open": -0.25, "close": 0.5, "curve": curve})
    u = random_u(1 << 16)
    _, _, time = shoot(camera, u)
    assert time.min() >= -0.25
    assert time.max() <= 0.5
    seen = np.bincount(((time + 0.25) / 0.75 * cells).astype(int).clip(0, cells - 1), minlength=cells)
    fine = np.linspace(0, 1, cells * 100 + 1)
    density = np.interp(fine, np.linspace(0, 1, len(curve)), curve)
    mass = (0.5 * (density[1:] + density[:-1])).reshape(cells, 100).sum(axis=1)
    expected = mass / mass.sum() * len(time)
    some = expected > 5
    assert seen[expected == 0].sum() == 0
    statistic = ((seen[some] - expected[some]) ** 2 / expected[some]).sum()
    assert chi2.sf(statistic, some.sum() - 1) > FALSE_ALARM


def moving(*steps: Any) -> dict[str, Any]:
    return {"keyframes": [{"time": float(t), "transform": s} for t, s in enumerate(steps)]}


@pytest.mark.parametrize("transform", ["turning", "mirrored", "scaled"])
def test_a_moving_camera_is_a_moving_world(shoot: Shoot, transform: str) -> None:
    """Half a turn over the shutter; rays at time t are those of a still camera placed as at t."""
    mirror = [{"scale": [-1, 1, 1]}] if transform == "mirrored" else []
    scale = [{"scale": [2, 3, 1]}] if transform == "scaled" else []
    turn = [{"rotate": {"axis": [0, 1, 0], "angle": 180}}, {"translate": [1, 2, 3]}]
    steps = moving([*mirror, *scale], [*mirror, *scale, *turn])
    camera = camera_of(transform=steps, shutter={"open": 0, "close": 1})
    u = random_u(512)
    o, d, time = shoot(camera, u)
    plain = camera_of(transform=moving(mirror, [*mirror, *turn]), shutter={"open": 0, "close": 1})
    _, still, _ = shoot(camera_of(), u, motion=0)
    for i in range(0, 512, 16):
        m = matrix_at(plain.transform, float(time[i]))
        np.testing.assert_allclose(d[i], m[:3, :3] @ still[i], atol=2e-6)
        np.testing.assert_allclose(o[i], m[:3, 3], atol=2e-6)


def test_scale_in_a_cameras_transform_counts_for_nothing(shoot: Shoot) -> None:
    scaled = camera_of(transform=[{"scale": [3, 3, 3]}, LOOK])
    for a, b in zip(shoot(scaled, random_u()), shoot(camera_of(transform=[LOOK]), random_u()), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_far_cameras_keep_their_precision_by_the_anchor(shoot: Shoot) -> None:
    far = {"look_at": {"origin": [1e9 + 0.25, 0, 0], "target": [1e9 + 0.25, 0, -1]}}
    o, _, _ = shoot(camera_of(transform=far), random_u(4), anchor=(1e9, 0.0, 0.0))
    np.testing.assert_array_equal(o, np.broadcast_to([0.25, 0, 0], (4, 3)))


def test_frames_shift_the_motion_but_not_the_shutters_clock(shoot: Shoot) -> None:
    camera = camera_of(transform=moving([], [{"translate": [8, 0, 0]}]), shutter={"open": 0, "close": 0.25})
    o, _, time = shoot(camera, random_u(64), time=0.5)
    assert time.min() >= 0
    assert time.max() <= 0.25
    np.testing.assert_allclose(o[:, 0], 8 * (0.5 + time), rtol=1e-6)
