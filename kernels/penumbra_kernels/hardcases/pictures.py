"""Hard cases 48-55: whole pictures. What the single mechanisms promise has to hold when they work together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene
from scipy import stats

from penumbra_kernels.assets import Image
from penumbra_kernels.hardcases.benches.geometry import Meshes
from penumbra_kernels.hardcases.benches.pictures import Picture, Renderer, busy
from penumbra_kernels.hardcases.benches.transformed import transformed
from penumbra_kernels.hardcases.case import (
    FALSE_ALARM,
    HardCase,
    Measure,
    Workbench,
    Z,
    at_least,
    at_most,
    enough,
    hard_case,
)
from penumbra_kernels.hardcases.lights import many_powers

BLOCK: Final = 8
BLACK: Final = {"type": "diffuse", "base_color": 0}
GRAY: Final = {"type": "diffuse", "base_color": 0.5}
FLOOR: Final = {
    "type": "quad",
    "origin": [-50, 0, 50],
    "u": [100, 0, 0],
    "v": [0, 0, -100],
    "material": "gray",
}
DOWN: Final = {
    "type": "perspective",
    "fov": 0.2,
    "transform": {"look_at": {"origin": [3, 2, 0], "target": [0, 0, 0]}},
}
"""Sees two centimetres of floor about the origin."""


def same_picture(what: str, a: Picture, b: Picture) -> Iterator[Measure]:
    """Two renders of one picture with noise of their own: the overall mean, and means of 8 x 8 blocks."""
    difference, variance = (a.mean - b.mean).sum(axis=2), (a.variance + b.variance).sum(axis=2) * 3
    # Channels of a pixel may be wholly correlated: the variance of their sum is at most three times the variances' sum.
    z = difference.sum() / math.sqrt(max(variance.sum(), 1e-300))
    yield at_most(f"|z| of the picture's mean, {what}", abs(z), Z)
    h, w = (n // BLOCK for n in difference.shape)
    blocks = [
        x[: h * BLOCK, : w * BLOCK].reshape(h, BLOCK, w, BLOCK).sum(axis=(1, 3))
        for x in (difference, variance)
    ]
    # Blocks without noise differ by rounding.
    floor = (1e-5 * (a.mean.mean() + b.mean.mean()) * BLOCK**2) ** 2
    rms = math.sqrt(
        np.mean(blocks[0] ** 2 / np.maximum(blocks[1] + floor, 1e-300))
    )  # black pictures are the same
    yield at_most(
        f"rms z of its blocks, {what}", rms, math.sqrt(stats.chi2.isf(FALSE_ALARM, h * w) / (h * w))
    )
    yield at_most(
        f"rejected samples, {what}", b.node.sums["rejected"].sum() + a.node.sums["rejected"].sum(), 0
    )


def _document() -> dict[str, Any]:
    return busy("sobol", side=32).model_dump(mode="json", exclude_unset=True)


def _compared(bench: Workbench, changes: dict[str, dict[str, Any]]) -> Iterator[Measure]:
    render = bench.get(Renderer)
    samples = bench.count(64, 1024)
    original = render(Scene.model_validate(_document()), samples=samples)
    for what, change in changes.items():
        yield from same_picture(
            what, original, render(Scene.model_validate(transformed(_document(), **change)), samples=samples)
        )


ANCHORED: Final = "Lengths relative to the camera's place, subtracted in float64; no constant has a length"


@hard_case(
    48,
    "scaled-picture",
    "A scene of every effect, a million times smaller and larger, is the same picture.",
    oracle="the picture at scale 1, within noise",
    algorithm=ANCHORED,
)
def scaled_picture(bench: Workbench) -> Iterator[Measure]:
    yield from _compared(bench, {f"scale {scale:g}": {"scale": scale} for scale in (1e-6, 1e6)})


@hard_case(
    49,
    "moved-picture",
    "The scene moved by a thousand kilometres is the same picture.",
    oracle="the picture at the origin, within noise",
    algorithm=ANCHORED,
)
def moved_picture(bench: Workbench) -> Iterator[Measure]:
    yield from _compared(
        bench, {"moved by 1e6": {"move": (1e6, -1e6, 1e6)}, "moved by 1e6 along z": {"move": (0, 0, 1e6)}}
    )


@hard_case(
    50,
    "turned-picture",
    "The scene turned as a whole, so that nothing is parallel to an axis, is the same picture.",
    oracle="the picture as it was, within noise",
    algorithm="Nothing prefers an axis: precise sphere and triangle tests, robust slabs, Duff's frames",
)
def turned_picture(bench: Workbench) -> Iterator[Measure]:
    turns = {"turned by 67 degrees": ([1, 2, 3], 67.0), "turned upside down": ([1, 0, 0], 180.0)}
    yield from _compared(
        bench, {what: {"rotate": {"axis": axis, "angle": angle}} for what, (axis, angle) in turns.items()}
    )


@hard_case(
    51,
    "planet-picture",
    "The earth, a sphere of 6371 km, by a low sun, from a person's eye height of 1.7 m.",
    oracle="albedo / pi E sin(height) with the curved normal, to 1e-3 in every pixel of ground; the sky exactly black",
    algorithm="Precise discriminant, hits put back on the sphere (Haines et al. 2019), bounds for spawning (pbrt-v4 6.8)",
)
def planet_picture(bench: Workbench) -> Iterator[Measure]:
    r, eye, side, fov, sun = 6.371e6, 1.7, 32, 20.0, math.radians(5)
    light = {"type": "directional", "direction": [0, -math.sin(sun), -math.cos(sun)], "irradiance": math.pi}
    scene = {
        "camera": {"type": "perspective", "fov": fov},
        "film": {"width": side, "height": side},
        "materials": {"gray": GRAY},
        "shapes": [{"type": "sphere", "center": [0, -r - eye, 0], "radius": r, "material": "gray"}],
        "lights": [light],
        "integrator": {"max_bounces": 1},
    }
    picture = bench.get(Renderer)(scene, samples=64)
    pixel = 2 * math.tan(math.radians(fov / 2)) / side
    x, y = np.meshgrid(
        (np.arange(side) + 0.5) * pixel - side * pixel / 2, side * pixel / 2 - (np.arange(side) + 0.5) * pixel
    )
    d = np.stack([x, y, -np.ones_like(x)], axis=2)
    d /= np.linalg.norm(d, axis=2, keepdims=True)
    dip = math.sqrt(2 * eye / r)
    ground, sky = y + pixel / 2 < -dip - 0.01, y - pixel / 2 > -dip
    b, c = d[..., 1] * (r + eye), (r + eye) ** 2 - r**2
    t = c / (-b + np.sqrt(np.maximum(b * b - c, 0)))
    normal = (t[..., None] * d + np.array([0, r + eye, 0])) / r
    expected = 0.5 * (normal @ np.array([0, math.sin(sun), math.cos(sun)]))
    error = np.abs(picture.mean[..., 0] / expected - 1)
    yield at_most("largest relative error of a pixel of ground", error[ground].max(), 1e-3)
    yield at_most("brightest pixel of sky", picture.mean[sky].max(), 0)
    yield enough("pixels of ground", np.count_nonzero(ground), 100)


@hard_case(
    52,
    "room-of-mirrors",
    "A room of mirrors whose end wall shines, seen along paths of up to a thousand bounces.",
    oracle="the unfolded room in float64: 1 where the path reaches the wall in time, 0 elsewhere; outside shines 100",
    algorithm="Spawned rays start outside their point's error box (pbrt-v4 6.8.6); paths end by max_bounces alone",
)
def room_of_mirrors(bench: Workbench) -> Iterator[Measure]:
    side, depth = 32, 1000
    camera = {
        "type": "perspective",
        "fov": 2,
        "transform": {"look_at": {"origin": [0, 0.1, 0], "target": [1, 0.1, 0]}},
    }
    walls = [
        {"type": "quad", "origin": o, "u": u, "v": v, "material": "mirror"}
        for o, u, v in (
            ([-1, -1, -1], [0, 2, 0], [0, 0, 2]),
            ([1, -1, -1], [0, 0, 2], [0, 2, 0]),
            ([-1, -1, -1], [0, 0, 2], [2, 0, 0]),
            ([-1, 1, -1], [2, 0, 0], [0, 0, 2]),
            ([-1, -1, -1], [2, 0, 0], [0, 2, 0]),
        )
    ]
    end = {"type": "quad", "origin": [-1, -1, 1], "u": [0, 2, 0], "v": [2, 0, 0], "material": "black"}
    scene = {
        "camera": camera,
        "film": {"width": side, "height": side},
        "materials": {"mirror": {"type": "mirror"}, "black": BLACK},
        "shapes": [*walls, {**end, "emission": {"radiance": 1, "two_sided": True}}],
        "environment": {"type": "constant", "radiance": 100},
        "sampler": {"type": "regular"},
        "integrator": {"max_bounces": depth},
    }
    seen = bench.get(Renderer)(scene, samples=1, replicates=1).mean[..., 0]
    bounces = _bounces_to_the_end_wall(side)
    clear = np.abs(bounces - depth) > 2
    yield at_most("brightest pixel: more is a leak", seen.max(), 1)
    yield at_most("pixels unlike the unfolded room", np.count_nonzero((seen != (bounces <= depth))[clear]), 0)
    yield enough("bounces of the longest path that arrived", bounces[(seen == 1) & clear].max(), 500)


def _bounces_to_the_end_wall(side: int) -> NDArray[np.float64]:
    """Mirrors met on the way from the room's middle to z = 1 by the ray through each pixel's centre."""
    pixel = 2 * math.tan(math.radians(1)) / side
    right, up = np.meshgrid(
        (np.arange(side) + 0.5 - side / 2) * pixel, (side / 2 - np.arange(side) - 0.5) * pixel
    )
    # Looking along +x with y up, right is +z.
    way = np.where(right > 0, 1.0, 3.0) / np.abs(right)
    across = np.floor((way + 1) / 2)
    height = np.abs(0.1 + way * up)
    return np.asarray(across + np.floor((height + 1) / 2) + (right < 0))


@hard_case(
    53,
    "picture-by-ten-thousand-lights",
    "A floor lit by ten thousand point lights with powers from 1e-6 to 1e6.",
    oracle="the sum over all lights in float64",
    algorithm="Lights chosen by their stated probabilities; every light with power has one",
)
def picture_by_ten_thousand_lights(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(4)
    powers = many_powers()
    places = rng.uniform(-5, 5, (len(powers), 3))
    places[:, 1] = rng.uniform(1, 6, len(powers))
    lights = [
        {"type": "point", "position": list(p), "intensity": i}
        for p, i in zip(places.tolist(), powers.tolist(), strict=True)
    ]
    scene = {
        "camera": DOWN,
        "film": {"width": 8, "height": 8},
        "materials": {"gray": GRAY},
        "shapes": [FLOOR],
        "lights": lights,
        "integrator": {"max_bounces": 0},
    }
    picture = bench.get(Renderer)(scene, samples=bench.count(256, 4096))
    r2 = (places**2).sum(axis=1)
    exact = 0.5 / math.pi * (powers * places[:, 1] / r2**1.5).sum()
    error = np.sqrt(picture.variance.sum()) / picture.mean.size * math.sqrt(3)
    # The picture spans two centimetres of floor.
    yield at_most("|z| of the mean", max(abs(picture.mean.mean() - exact) - 1e-4 * exact, 0) / error, Z)
    yield at_most("relative standard error of the mean", error / exact, 0.05)


@hard_case(
    54,
    "needle-mesh-picture",
    "A wall of needles, a metre long and down to a millionth wide, is a wall without holes.",
    oracle="the wall shines 1: every sample is 1",
    algorithm="Watertight edge functions (Woop, Benthin, Wald 2013) with exact signs",
)
def needle_mesh_picture(bench: Workbench) -> Iterator[Measure]:
    widths = np.geomspace(1e-6, 1e-2, 600)
    x = np.concatenate([[0], np.cumsum(widths)])
    x = (x / x[-1] - 0.5).astype(np.float32)
    x = np.unique(x)
    n = len(x)
    vertices = np.concatenate([np.stack([x, np.full(n, y), np.full(n, -1.0)], 1) for y in (-0.5, 0.5)])
    i = np.arange(n - 1)
    faces = np.concatenate([np.stack([i, i + 1, n + i + 1], 1), np.stack([i, n + i + 1, n + i], 1)])
    held = Meshes()
    wall = {**held.add(vertices, faces), "material": "black", "emission": {"radiance": 1, "two_sided": True}}
    side = 32
    for name, turn in (("upright", []), ("turned", [{"rotate": {"axis": [0, 0, 1], "angle": 33}}])):
        camera = {"type": "orthographic", "height": 0.6}
        scene = {
            "camera": camera,
            "film": {"width": side, "height": side},
            "materials": {"black": BLACK},
            "shapes": [{**wall, "transform": turn}],
            "integrator": {"max_bounces": 0},
        }
        picture = bench.get(Renderer)(scene, samples=bench.count(64, 1024), assets=held)
        yield at_most(f"pixels that are not exactly 1, {name}", np.count_nonzero(picture.mean != 1), 0)


class _Sky(Meshes):
    def __init__(self, pixels: NDArray[np.float32]) -> None:
        super().__init__()
        self.pixels = pixels

    def image(self, ref: Any) -> Image:
        return Image(self.pixels, False)


@hard_case(
    55,
    "bright-texel-picture",
    "A floor under a sky of 0.7 with one texel of 1e6.",
    oracle="the integral of the bilinear sky times the cosine in float64",
    algorithm="The sky sampled by its texels' energy, joined with the surface's lobe (Veach 1997, power heuristic)",
)
def bright_texel_picture(bench: Workbench) -> Iterator[Measure]:
    height, width, row, column = 128, 256, 30, 77
    pixels = np.full((height, width, 3), 0.7, np.float32)
    pixels[row, column] = 1e6
    scene = {
        "camera": DOWN,
        "film": {"width": 8, "height": 8},
        "materials": {"gray": GRAY},
        "shapes": [FLOOR],
        "environment": {"type": "image", "image": {"file": "sky.exr"}},
        "integrator": {"max_bounces": 0},
    }
    picture = bench.get(Renderer)(scene, samples=bench.count(512, 8192), assets=_Sky(pixels))
    fine = 32  # cells a texel, each way, over the 3 x 3 that the bright one bleeds into
    at = (np.arange(3 * fine) + 0.5) / fine - 1.5
    tent = np.maximum(1 - np.abs(at), 0)
    v = (row + 0.5 + at) / height
    cell = (math.pi / height / fine) * (2 * math.pi / width / fine)
    sun = (1e6 - 0.7) * tent.sum() * (tent * np.cos(math.pi * v) * np.sin(math.pi * v)).sum() * cell
    exact = 0.5 / math.pi * (0.7 * math.pi + sun)
    error = np.sqrt(picture.variance.sum()) / picture.mean.size * math.sqrt(3)
    yield at_most("|z| of the mean", max(abs(picture.mean.mean() - exact) - 1e-3 * exact, 0) / error, Z)
    yield at_most("relative standard error of the mean", error / exact, 0.05)
    yield at_least("share of the bright texel in the light", sun / (sun + 0.7 * math.pi), 0.5)


CASES: Final[tuple[HardCase, ...]] = (
    scaled_picture,
    moved_picture,
    turned_picture,
    planet_picture,
    room_of_mirrors,
    picture_by_ten_thousand_lights,
    needle_mesh_picture,
    bright_texel_picture,
)
