"""The environment: its frame, exact probabilities, samples that follow the image, one blinding texel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from penumbra_kernels.assets import AssetError, Image
from penumbra_kernels.compile.alias import STEPS
from penumbra_kernels.compile.environment import compile_environment, row_solid_angles, texel_means
from penumbra_kernels.hardcases.lights import environment_scene, texel_probabilities
from penumbra_scene.lights import ImageEnvironment


class OneImage:
    """Assets with a single image."""

    def __init__(self, pixels: np.ndarray, eight_bit: bool = False) -> None:
        self.pixels, self.eight_bit = pixels, eight_bit

    def image(self, ref):
        return Image(np.asarray(self.pixels, np.float32), self.eight_bit)

    def mesh(self, ref):
        raise AssertionError


def compiled(pixels, transform=(), scale=1.0, eight_bit=False):
    model = ImageEnvironment.model_validate(
        {"type": "image", "image": {"file": "sky.exr"}, "scale": scale, "transform": transform}
    )
    return compile_environment(model, OneImage(pixels, eight_bit), 0.0)


def noise(height: int, width: int, seed: int = 1) -> np.ndarray:
    """An image that spans four decades, with black texels."""
    rng = np.random.default_rng(seed)
    pixels = 10.0 ** rng.uniform(-2, 2, (height, width, 3))
    pixels[rng.random((height, width)) < 0.3] = 0.0
    return pixels.astype(np.float32)


def direction(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Of image coordinates: v down from +Y, u to the right with -Z in the middle and +X right of it."""
    theta, phi = math.pi * v, 2 * math.pi * (u - 0.5)
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)


def uv_of(d: np.ndarray) -> np.ndarray:
    d = np.asarray(d, np.float64)
    u = np.arctan2(d[:, 0], -d[:, 2]) / (2 * math.pi) + 0.5
    return np.stack([u, np.arctan2(np.hypot(d[:, 0], d[:, 2]), d[:, 1]) / math.pi], 1)


def bilinear(pixels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """The image at (u, v) in float64: columns wrap, rows end."""
    h, w = pixels.shape[:2]
    x, y = uv[:, 0] * w - 0.5, uv[:, 1] * h - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    at = lambda j, i: pixels.astype(np.float64)[np.clip(j, 0, h - 1), i % w]  # noqa: E731
    top = at(y0, x0) * (1 - fx) + at(y0, x0 + 1) * fx
    return top * (1 - fy) + (at(y0 + 1, x0) * (1 - fx) + at(y0 + 1, x0 + 1) * fx) * fy


def test_axes_of_the_image(bench) -> None:
    """+Y is the top row, -Z the centre column, +X the right half's middle."""
    pixels = np.zeros((8, 16, 3), np.float32)
    pixels[0] = 1.0
    pixels[4, 8] = pixels[3, 8] = pixels[3, 7] = pixels[4, 7] = 2.0
    pixels[3:5, 11:13] = 3.0
    scene = environment_scene(bench, compiled(pixels))
    axes = np.array([[0, 1, 0], [0, 0, -1], [1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    radiance, _ = bench.sky(scene, axes)
    assert np.allclose(radiance[:, 0], [1, 2, 3, 0, 0, 0], atol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (7, 13), (64, 128)])
def test_lookup_is_bilinear(bench, shape) -> None:
    pixels = noise(*shape)
    d = np.random.default_rng(3).normal(size=(4000, 3))
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    radiance, _ = bench.sky(environment_scene(bench, compiled(pixels, scale=2.0)), d)
    expected = 2.0 * bilinear(pixels, uv_of(d))
    assert np.allclose(radiance, expected, atol=1e-5 * 100 * max(shape))


def test_texel_means_are_integrals_of_the_bilinear_image() -> None:
    pixels = noise(5, 7).mean(axis=2).astype(np.float64)
    fine = 64
    x, y = (np.arange(7 * fine) + 0.5) / (7 * fine), (np.arange(5 * fine) + 0.5) / (5 * fine)
    uv = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    values = bilinear(pixels[..., None], uv).reshape(5, fine, 7, fine)
    padded = np.concatenate([pixels[:1], pixels, pixels[-1:]])
    assert np.allclose(texel_means(padded), values.mean(axis=(1, 3)), rtol=1e-3)


def test_rows_cover_the_sphere() -> None:
    assert row_solid_angles(37).sum() == pytest.approx(4 * math.pi, rel=1e-12)
    first = 2 * math.pi * (1 - math.cos(math.pi / 37))
    assert row_solid_angles(37)[0] == pytest.approx(first, rel=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (64, 128)])
def test_probabilities_follow_the_image(shape) -> None:
    pixels = noise(*shape)
    env = compiled(pixels)
    gray = pixels.astype(np.float64).mean(axis=2)
    means = texel_means(np.concatenate([gray[:1], gray, gray[-1:]]))
    weights = means * row_solid_angles(shape[0])[:, None] / shape[1]
    p = texel_probabilities(env)
    assert p.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.array_equal(p > 0, weights > 0)
    # one step of 2^-24 in a row's choice, and one in its column's
    rows = weights.sum(axis=1, keepdims=True) / weights.sum()
    assert np.all(np.abs(p - weights / weights.sum()) <= (2 * p / np.maximum(rows, 1e-30) + 2 * rows) / STEPS)
    assert env.flux == pytest.approx(weights.sum() * 1.0, rel=1e-12)


@pytest.mark.parametrize("transform", [(), [{"rotate": {"axis": [1, 2, -0.5], "angle": 70}}, {"scale": 3}]])
def test_samples_follow_the_density(bench, transform) -> None:
    env = compiled(noise(12, 24), transform)
    scene = environment_scene(bench, env)
    count = 400_000
    s = bench.sample(scene, (0, 0, 0), bench.uniform(count, 5))
    assert len(s.pdf) == count
    assert np.all(np.isinf(s.distance))
    assert not s.delta.any()
    local = s.wi.astype(np.float64) @ env.environment_from_world.T
    uv = uv_of(local)
    fine = 3  # cells a texel, each way
    cell = np.clip((uv * [24 * fine, 12 * fine]).astype(int), 0, [24 * fine - 1, 12 * fine - 1])
    counts = np.bincount(cell[:, 1] * 24 * fine + cell[:, 0], minlength=24 * 12 * fine**2)
    expected = np.kron(texel_probabilities(env), np.full((fine, fine), 1 / fine**2)) * count
    # a direction at a texel's very edge may round to its neighbour
    counts = counts.reshape(12 * fine, 24 * fine)
    stray = counts[expected == 0].sum()
    assert stray < 20
    counts[expected == 0] = 0
    expected *= counts.sum() / expected.sum()
    assert bench.chi2_pvalue(counts, expected) > 1e-6


@pytest.mark.parametrize("transform", [(), [{"rotate": {"axis": [1, 2, -0.5], "angle": 70}}]])
def test_a_samples_density_and_radiance_are_those_of_its_direction(bench, transform) -> None:
    scene = environment_scene(bench, compiled(noise(12, 24), transform))
    s = bench.sample(scene, (0, 0, 0), bench.uniform(100_000, 6))
    radiance, pdf = bench.sky(scene, s.wi)
    inside = np.isclose(pdf, s.pdf, rtol=1e-4)
    assert np.mean(~inside) < 1e-4  # rounded across a texel's edge
    assert np.allclose(radiance, s.radiance, atol=1e-3 * 100)


def test_density_integrates_to_one(bench) -> None:
    scene = environment_scene(bench, compiled(noise(9, 16)))
    w, h = 16 * 24, 9 * 24
    u, v = np.meshgrid((np.arange(w) + 0.5) / w, (np.arange(h) + 0.5) / h)
    d = direction(u.ravel(), v.ravel())
    _, pdf = bench.sky(scene, d)
    sine = np.sin(math.pi * v.ravel())
    assert np.sum(pdf * sine) * 2 * math.pi**2 / (w * h) == pytest.approx(1.0, rel=1e-5)


def test_estimate_of_the_flux_is_unbiased(bench) -> None:
    """Mean of radiance / density over all samples is the image's integral, dim and black texels included."""
    env = compiled(noise(16, 32))
    s = bench.sample(environment_scene(bench, env), (0, 0, 0), bench.uniform(1_000_000, 7))
    values = s.radiance.astype(np.float64).mean(axis=1) / s.pdf
    w, h = 32 * 32, 16 * 32
    u, v = np.meshgrid((np.arange(w) + 0.5) / w, (np.arange(h) + 0.5) / h)
    fine = bilinear(noise(16, 32), np.stack([u.ravel(), v.ravel()], 1)).mean(axis=1)
    exact = np.sum(fine * np.sin(math.pi * v.ravel())) * 2 * math.pi**2 / (w * h)
    error = values.std() / math.sqrt(len(values))
    assert abs(values.mean() - exact) < 5 * error + 1e-4 * exact
    assert values.std() < 2 * exact  # the density follows the image


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (0.48, -0.6, 0.64)])
def test_constant_environment_follows_the_cosine_to_the_normal(bench, normal) -> None:
    """The square of the cosine and the azimuth are uniform, and the density is the cosine over pi."""
    scene = bench.scene([bench.light("environment", radiance=1)], environment_light=0)
    count, bins = 400_000, 24
    n = np.array(normal, np.float64)
    x = np.cross(n, [0, 1, 0])
    x /= np.linalg.norm(x)
    s = bench.sample(scene, (5, 6, 7), bench.uniform(count, 9), n=n)
    assert len(s.pdf) == count
    wi = s.wi.astype(np.float64)
    cosine = wi @ n
    assert np.all(cosine > 0)
    assert np.allclose(s.pdf, cosine / math.pi, rtol=0, atol=1e-6)
    height = np.clip((cosine**2 * bins).astype(int), 0, bins - 1)
    angle = np.arctan2(wi @ np.cross(n, x), wi @ x) / (2 * math.pi) + 0.5
    turn = np.clip((angle * bins).astype(int), 0, bins - 1)
    counts = np.bincount(height * bins + turn, minlength=bins * bins)
    assert bench.chi2_pvalue(counts, np.full(bins * bins, count / bins**2)) > 1e-6
    _, pdf = bench.sky(scene, s.wi, n)
    assert np.allclose(pdf, s.pdf, rtol=0, atol=1e-6)
    _, behind = bench.sky(scene, -s.wi[:100], n)
    assert np.all(behind == 0)


def test_constant_environment_is_uniform_over_the_sphere(bench) -> None:
    scene = bench.scene([bench.light("environment", radiance=(1, 2, 3))], environment_light=0)
    count, bins = 400_000, 24
    s = bench.sample(scene, (5, 6, 7), bench.uniform(count, 8))
    assert np.allclose(s.pdf, 1 / (4 * math.pi))
    assert np.array_equal(s.radiance, np.tile(np.float32([1, 2, 3]), (count, 1)))
    height = np.clip(((s.wi[:, 2] + 1) / 2 * bins).astype(int), 0, bins - 1)
    angle = np.arctan2(s.wi[:, 1], s.wi[:, 0]) / (2 * math.pi) + 0.5
    turn = np.clip((angle * bins).astype(int), 0, bins - 1)
    counts = np.bincount(height * bins + turn, minlength=bins * bins)
    assert bench.chi2_pvalue(counts, np.full(bins * bins, count / bins**2)) > 1e-6
    radiance, pdf = bench.sky(scene, s.wi[:100])
    assert np.array_equal(radiance, s.radiance[:100])
    assert np.array_equal(pdf, s.pdf[:100])


def test_poles_are_finite(bench) -> None:
    scene = environment_scene(bench, compiled(noise(2, 4)))
    d = np.array([[0, 1, 0], [0, -1, 0], [1e-20, 1, 0], [0, -1, 1e-30], [-0.0, 1, -0.0]])
    radiance, pdf = bench.sky(scene, d)
    assert np.all(np.isfinite(radiance))
    assert np.all(np.isfinite(pdf))


def test_eight_bit_images_are_srgb() -> None:
    env = compiled(np.full((2, 4, 3), 0.5), eight_bit=True)
    assert np.allclose(env.buffer[:8, :3], 0.21404114, rtol=1e-6)


@pytest.mark.parametrize("bad", [np.zeros((0, 4, 3)), np.zeros((4, 4)), np.full((2, 2, 3), np.nan)])
def test_broken_images_are_refused(bad) -> None:
    with pytest.raises(AssetError, match=r"sky\.exr"):
        compiled(bad)


def test_a_black_image_gives_nothing_and_breaks_nothing(bench) -> None:
    scene = environment_scene(bench, compiled(np.zeros((4, 8, 3))))
    s = bench.sample(scene, (0, 0, 0), bench.uniform(1000, 9))
    assert not s.radiance.any()
    assert np.all(np.isfinite(s.pdf))
