"""Hard cases 26-32: lights near, far, edge-on, blinding and many. Metres; the lit point is at the origin unless told."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.lights import ImageEnvironment

from penumbra_kernels.assets import Image, NoAssets
from penumbra_kernels.compile.alias import STEPS, alias_table
from penumbra_kernels.compile.environment import CompiledEnvironment, compile_environment, row_solid_angles
from penumbra_kernels.hardcases.benches.lights import LightBench, LightScene, mesh_light
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

UNIT: Final = {"position": (-0.5, 0.0, -0.5), "direction": (1.0, 0.0, 0.0), "axis_v": (0.0, 0.0, 1.0)}
"""A unit square about the origin that emits downwards."""
TRIANGLE: Final = np.array([[-0.4, 1.0, -0.3], [0.1, 1.1, 0.6], [0.7, 0.9, -0.2]])
"""At a height of 1 over the lit point."""


def _one(bench: LightBench, kind: str, **values: Any) -> LightScene:
    return bench.scene([bench.light(kind, **values)])


def _lit(samples: Any, count: int) -> NDArray[np.float64]:
    """(count,) cosine over density of each sample, 0 where the light gave none: the irradiance of radiance 1 is their mean."""
    values = np.zeros(count)
    values[samples.index] = samples.wi[:, 1].astype(np.float64) / samples.pdf
    return values


@hard_case(
    26,
    "rectangle-light",
    "A rectangle light of 1 x 1 at distances from 0.1 to 1e4 gives its form factor and its solid angle.",
    oracle="closed forms in float64 (Howell C-11), relative error 1e-5, by a 512 x 512 midpoint rule over the samples",
    algorithm="Spherical rectangles (Urena, Fajardo, King 2013) near; by area where the solid angle is tiny",
)
def rectangle_light(bench: Workbench) -> Iterator[Measure]:
    lights = bench.get(LightBench)
    scene = _one(lights, "quad", **UNIT)
    for distance in (0.1, 1.0, 30.0, 1e2, 1e3, 1e4):
        s = lights.sample(scene, (0.0, -distance, 0.0), lights.grid(512))
        x = 0.5 / distance
        exact = 4 * x / math.sqrt(1 + x * x) * math.atan(x / math.sqrt(1 + x * x))
        mean = _lit(s, 512 * 512).mean()
        yield at_most(f"relative error of the irradiance, distance {distance:g}", abs(mean / exact - 1), 1e-5)
    for distance in (30.0, 1e2, 1e3, 1e4):
        s = lights.sample(scene, (0.3, -distance, 0.1), lights.grid(256))
        # Differences of arc tangents cancel even in float64: far away the series' first term is enough.
        near = _rectangle_solid_angle(-0.8, 0.2, -0.6, 0.4, distance)
        exact = near if distance < 1e3 else distance / (distance**2 + 0.1) ** 1.5
        error = abs(np.mean(1.0 / s.pdf.astype(np.float64)) / exact - 1)
        yield at_most(f"relative error of the solid angle, distance {distance:g}", error, 1e-5)


def _rectangle_solid_angle(x0: float, x1: float, y0: float, y1: float, h: float) -> float:
    """Of [x0, x1] x [y0, y1] in a plane at distance h, the foot at the origin."""

    def corner(x: float, y: float) -> float:
        return math.atan2(x * y, h * math.sqrt(x * x + y * y + h * h))

    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)


def triangle_irradiance(corners: NDArray[np.float64], normal: NDArray[np.float64]) -> float:
    """At the origin, of radiance 1, wholly above the horizon (Lambert 1760), in float64."""
    unit = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(unit, np.roll(unit, -1, axis=0), strict=True):
        cross = np.cross(a, b)
        sine = float(np.linalg.norm(cross))
        total += math.atan2(sine, float(a @ b)) * float(cross @ normal) / sine
    return abs(total) / 2


def _far_irradiance(corners: NDArray[np.float64]) -> float:
    """The first term of the multipole series, whose error is (size / distance)^2: 1e-6 from a thousand metres on."""
    center = corners.mean(axis=0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0]) / 2
    r = float(np.linalg.norm(center))
    return float(abs(normal @ center) / r**3 * center[1] / r)


@hard_case(
    27,
    "triangle-light",
    "A triangle light of about 1 metre at distances from 0.3 to 1e4.",
    oracle="Lambert's closed form in float64, far away the first term of the multipole series; relative error 1e-5",
    algorithm="Spherical triangles (Arvo 1995) near; by area where the solid angle is tiny",
)
def triangle_light(bench: Workbench) -> Iterator[Measure]:
    lights = bench.get(LightBench)
    for distance in (0.3, 1.0, 30.0, 1e2, 1e3, 1e4):
        corners = (TRIANGLE + np.array([0, distance - 1, 0])).astype(np.float32).astype(np.float64)
        faces_down = np.cross(corners[1] - corners[0], corners[2] - corners[0])[1] < 0
        scene, _ = mesh_light(lights, corners, [[0, 1, 2] if faces_down else [0, 2, 1]])
        s = lights.sample(scene, (0.0, 0.0, 0.0), lights.grid(512))
        exact = (
            triangle_irradiance(corners, np.array([0.0, 1.0, 0.0]))
            if distance < 1e3
            else _far_irradiance(corners)
        )
        error = abs(_lit(s, 512 * 512).mean() / exact - 1)
        yield at_most(f"relative error of the irradiance, distance {distance:g}", error, 1e-5)


@hard_case(
    28,
    "far-sphere-light",
    "A sphere light seen under r / d of 0.5 down to 1e-6.",
    oracle="E = pi L (r / d)^2 cos(theta), relative error 1e-5",
    algorithm="Cone sampling with 1 - cos written as sin^2 / (1 + cos) (pbrt-v4 6.2.4)",
)
def far_sphere_light(bench: Workbench) -> Iterator[Measure]:
    lights = bench.get(LightBench)
    for ratio in (0.5, 1e-2, 1e-3, 1e-4, 1e-6):
        for tilt in (0.0, 0.4):
            d = 2.0 / ratio
            center = (math.sin(tilt) * d * 0.6, math.cos(tilt) * d, math.sin(tilt) * d * 0.8)
            s = lights.sample(_one(lights, "sphere", position=center, inner=2.0), (0, 0, 0), lights.grid(256))
            exact = math.pi * ratio**2 * math.cos(tilt)
            error = abs(_lit(s, 256 * 256).mean() / exact - 1)
            yield at_most(f"relative error of the irradiance, r / d {ratio:g}, tilt {tilt:g}", error, 1e-5)


@hard_case(
    29,
    "light-touching-the-floor",
    "A unit wall light that stands on the floor lights the floor 1e-1 to 1e-3 metres in front of it.",
    oracle="F = [atan(1/c) - c / sqrt(1 + c^2) atan(1 / sqrt(1 + c^2))] / (2 pi), to the midpoint rule's 2e-4",
    algorithm="Spherical rectangles (Urena et al. 2013): by area the relative deviation would be 3.5, 35 and 424",
)
def light_touching_the_floor(bench: Workbench) -> Iterator[Measure]:
    lights = bench.get(LightBench)
    scene = _one(lights, "quad", position=(0.0, 0.0, 0.0), direction=(0.0, 1.0, 0.0), axis_v=(0.0, 0.0, 1.0))
    for c in (1e-1, 1e-2, 1e-3):
        s = lights.sample(scene, (c, 0.0, 0.0), lights.grid(512))
        exact = 0.5 * (math.atan(1 / c) - c / math.sqrt(1 + c * c) * math.atan(1 / math.sqrt(1 + c * c)))
        values = _lit(s, 512 * 512)
        yield at_most(f"relative error of the irradiance, {c:g} m", abs(values.mean() / exact - 1), 2e-4)
        yield at_most(f"relative deviation of one sample, {c:g} m", values.std() / exact, 1.0)


@hard_case(
    30,
    "light-at-the-point",
    "Lights edge-on, behind, and at the very point that they light give nothing, or something finite.",
    oracle="no sample from behind or edge-on; elsewhere finite densities and unit directions",
    algorithm="A light whose solid angle is not positive and finite has no sample",
)
def light_at_the_point(bench: Workbench) -> Iterator[Measure]:
    lights = bench.get(LightBench)
    square = _one(lights, "quad", **UNIT)
    u = lights.uniform(2000, 8)
    dark = sum(
        len(lights.sample(square, p, u).pdf)
        for p in ((0, 1, 0), (0, 0, 0), (0.2, 0, 0.2), (3, 0, 0), (-0.5, 0, -0.5))
    )
    yield at_most("samples of a square from behind and edge-on", dark, 0)
    broken = seen = 0
    triangle, _ = mesh_light(lights, TRIANGLE, [[0, 1, 2]], flags=1)
    scenes = {
        "quad": _one(lights, "quad", **UNIT, flags=1),
        "disc": _one(
            lights, "disc", position=(0, 0, 0), direction=(0, -1, 0), axis_v=(1, 0, 0), inner=0.5, flags=1
        ),
        "sphere": _one(lights, "sphere", position=(0, 0, 0), inner=1.0, flags=1),
        "point": _one(lights, "point", position=(0.0, 0.0, 0.0)),
        "triangle": triangle,
    }
    places = [(x, -h, 0.1) for h in (0.0, 1e-6, 1e-4, 1e-2) for x in (0.0, 0.499999, 0.5, 0.500001, 0.7)]
    places += [
        (0, 1, 0),
        (0, 1 + 1e-7, 0),
        (0.6, 0.8, 0),
        (0, 0, 0),
        tuple(TRIANGLE[0]),
        tuple(TRIANGLE.mean(axis=0)),
    ]
    for scene in scenes.values():
        for p in places:
            s = lights.sample(scene, p, u)
            seen += len(s.pdf)
            finite = np.isfinite(s.pdf) & (s.pdf > 0) & np.isfinite(s.radiance).all(axis=1)
            unit = np.abs(np.linalg.norm(s.wi.astype(np.float64), axis=1) - 1) < 1e-5
            broken += int(np.count_nonzero(~(finite & unit)))
    yield at_most("broken samples of lights nearby", broken, 0)
    yield enough("samples of lights nearby", seen, 50_000)


class _OneImage(NoAssets):
    def __init__(self, pixels: NDArray[np.float32]) -> None:
        self.pixels = pixels

    def image(self, ref: Any) -> Image:
        return Image(self.pixels, False)


def _sky_with_a_sun(width: int) -> tuple[CompiledEnvironment, NDArray[np.float64]]:
    """0.7 everywhere, one texel of 1e6; and the exact probabilities of the 3 x 3 texels that it bleeds into."""
    height, row, column = width // 2, 700 * width // 4096, 1000 * width // 4096
    pixels = np.full((height, width, 3), 0.7, np.float32)
    pixels[row, column] = 1e6
    model = ImageEnvironment.model_validate({"type": "image", "image": {"file": "sky.exr"}})
    env = compile_environment(model, _OneImage(pixels), 0.0)
    angles = row_solid_angles(height)[row - 1 : row + 2] / width
    kernel = np.array([1, 6, 1]) / 8  # means of the bilinear image over texels
    low = np.float64(np.float32(0.7))
    bright = (1e6 - low) * np.outer(kernel, kernel)
    total = low * 4 * math.pi + (bright * angles[:, None]).sum()
    return env, (bright + low) * angles[:, None] / total


def texel_probabilities(env: CompiledEnvironment) -> NDArray[np.float64]:
    """(h, w) probability of each texel, as the device chooses it."""
    floats = env.buffer.reshape(-1)[env.first_cdf :].astype(np.float64)
    rows = np.diff(floats[: env.height + 1])
    columns = floats[env.height + 1 :][: env.height * (env.width + 1)].reshape(env.height, env.width + 1)
    return np.asarray(rows[:, None] * np.diff(columns, axis=1))


def environment_scene(bench: LightBench, env: CompiledEnvironment) -> LightScene:
    """A scene lit by this image alone."""
    a, b, c = env.environment_from_world
    record = bench.light(
        "environment",
        width=env.width,
        height=env.height,
        first_cdf=env.first_cdf,
        position=a,
        direction=b,
        axis_v=c,
    )
    return bench.scene([record], environment=env.buffer, environment_light=0)


@hard_case(
    31,
    "blinding-texel",
    "An environment of 4096 x 2048 texels of 0.7, one of them 1e6.",
    oracle="the bright texel's probability to 1e-5; chi^2 of samples over it and a grid of the sky",
    algorithm="Rows and columns, summed in float64, quantised to steps of 2^-24 with at least one for every texel",
)
def blinding_texel(bench: Workbench) -> Iterator[Measure]:
    width = 4096
    lights = bench.get(LightBench)
    env, exact = _sky_with_a_sun(width)
    p = texel_probabilities(env)
    row, column = 700, 1000
    around = np.s_[row - 1 : row + 2, column - 1 : column + 2]
    yield at_most(
        "relative error of the bright texels' probabilities", np.abs(p[around] / exact - 1).max(), 1e-5
    )
    yield at_least("smallest probability of a texel", p.min(), 2.0**-48)
    n = bench.count(200_000, 1_000_000)
    s = lights.sample(environment_scene(lights, env), (0, 0, 0), lights.uniform(n, 5))
    d = s.wi.astype(np.float64)
    u = np.arctan2(d[:, 0], -d[:, 2]) / (2 * np.pi) + 0.5
    v = np.arctan2(np.hypot(d[:, 0], d[:, 2]), d[:, 1]) / np.pi
    x, y = (
        np.clip((u * width).astype(int), 0, width - 1),
        np.clip((v * width // 2).astype(int), 0, width // 2 - 1),
    )
    sun = (abs(x - column) <= 2) & (abs(y - row) <= 2)
    side = width // 16
    counts = np.bincount(y[~sun] // side * 16 + x[~sun] // side, minlength=128)
    wide = p.copy()
    wide[row - 2 : row + 3, column - 2 : column + 3] = 0
    expected = np.append(wide.reshape(8, side, 16, side).sum(axis=(1, 3)).ravel(), 1 - wide.sum()) * n
    yield at_least(
        "p-value of the samples", lights.chi2_pvalue(np.append(counts, sun.sum()), expected), FALSE_ALARM
    )
    yield at_most(
        "samples without a density", np.count_nonzero(~(np.isfinite(s.pdf) & (s.pdf > 0))) + n - len(s.pdf), 0
    )


def many_powers() -> NDArray[np.float64]:
    """10,000 lights of powers 1e-6 to 1e6, every seventh without any."""
    powers = 10.0 ** np.random.default_rng(1).uniform(-6, 6, 10_000)
    powers[::7] = 0.0
    return powers


@hard_case(
    32,
    "ten-thousand-lights",
    "Ten thousand lights with powers from 1e-6 to 1e6, some without any.",
    oracle="the mean over choices is the sum of all powers; probabilities sum to 1; none for lights without power",
    algorithm="Alias table (Walker 1977; Vose 1991) in integer steps of 2^-24, so that the stated probabilities are exact",
)
def ten_thousand_lights(bench: Workbench) -> Iterator[Measure]:
    powers = many_powers()
    table = alias_table(powers)
    pmf = table["pmf"].astype(np.float64)
    yield at_most("deviation of the probabilities' sum from 1", abs(pmf.sum() - 1), 0)
    yield at_most("lights without power that may be chosen", np.count_nonzero(pmf[powers == 0]), 0)
    yield at_most("lights with power that may not", np.count_nonzero(pmf[powers > 0] == 0), 0)
    lights = bench.get(LightBench)
    scene = lights.scene([lights.light("point")] * len(table), light_table=table)
    k = np.arange(STEPS) if bench.full else np.random.default_rng(2).integers(0, STEPS, 1_000_000)
    light, told, same = lights.choose(scene, k * 2.0**-24)
    yield at_most(
        "choices whose probability is not the table's",
        np.count_nonzero((told != table["pmf"][light]) | (told != same)),
        0,
    )
    values = powers[light] / told.astype(np.float64)
    # Over all numbers of 24 bits the mean is the sum, but for rounding.
    error = (
        1e-9 * powers.sum() if bench.full else Z * values.std() / math.sqrt(len(values)) + 1e-9 * powers.sum()
    )
    yield at_most("error of the mean over its bound", abs(values.mean() - powers.sum()) / error, 1)
    # A light that is due less than a step has one: at most so many choices of 2^24 are worth less than the sum.
    yield at_most(
        "relative deviation of one choice", values.std() / powers.sum(), math.sqrt(len(powers) / STEPS)
    )


CASES: Final[tuple[HardCase, ...]] = (
    rectangle_light,
    triangle_light,
    far_sphere_light,
    light_touching_the_floor,
    light_at_the_point,
    blinding_texel,
    ten_thousand_lights,
)
