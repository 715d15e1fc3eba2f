"""Texture lookups on a device against numpy, and what compile_textures makes of images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import AssetError, Image, MeshData, NoAssets
from penumbra_kernels.compile.materials import compile_materials
from penumbra_kernels.compile.textures import compile_textures, srgb_to_linear
from penumbra_kernels.device import Device
from penumbra_kernels.layout import SHAPE
from penumbra_scene import limits
from penumbra_scene.assets import AssetRef
from penumbra_scene.scene import Scene

KERNEL = """
#include "materials/texture.cl"

__kernel void lookup(const __global Texture *textures, const __global float4 *texels,
                     const __global float *uv, const uint index, __global float *out) {
  const size_t i = get_global_id(0);
  SceneData scene;
  scene.textures = textures;
  scene.texels = texels;
  const float3 c = texture_lookup(&scene, index, (float2)(uv[2 * i], uv[2 * i + 1]));
  out[3 * i] = c.x;
  out[3 * i + 1] = c.y;
  out[3 * i + 2] = c.z;
}
"""


BSDF_KERNEL = """
#include "materials/bsdf.cl"

__kernel void colours(const __global ShapeData *shapes, const __global Material *materials,
                      const __global Texture *textures, const __global float4 *texels,
                      const __global float *uv, __global float *albedo) {
  const size_t i = get_global_id(0);
  SceneData scene;
  scene.shapes = shapes;
  scene.materials = materials;
  scene.textures = textures;
  scene.texels = texels;
  Surface s;
  s.ng = s.ns = (float3)(0.0f, 0.0f, 1.0f);
  s.tangent = (float3)(1.0f, 0.0f, 0.0f);
  s.uv = (float2)(uv[2 * i], uv[2 * i + 1]);
  s.shape = 0u;
  Bsdf b;
  bsdf_start(&scene, &s, s.ng, &b);
  albedo[6 * i] = b.color0.x;
  albedo[6 * i + 1] = b.color0.y;
  albedo[6 * i + 2] = b.color0.z;
  albedo[6 * i + 3] = b.color1.x;
  albedo[6 * i + 4] = b.color1.y;
  albedo[6 * i + 5] = b.color1.z;
}
"""


class Images:
    """Assets from arrays, counting how often each is decoded."""

    def __init__(self, **images: Image) -> None:
        self.images = images
        self.decoded: list[str] = []

    def image(self, ref: AssetRef) -> Image:
        assert ref.file is not None
        self.decoded.append(ref.file)
        return self.images[ref.file]

    def mesh(self, ref: AssetRef) -> MeshData:
        raise AssetError("no meshes here")


def scene_with(**textures: Any) -> Scene:
    return Scene.model_validate({"version": 1, "camera": {"type": "perspective"}, "textures": textures})


def picture(width: int = 7, height: int = 5, seed: int = 1) -> NDArray[np.float32]:
    return np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def lookup(device: Device) -> Any:
    kernel = device.build("texture_test", {}, text=KERNEL).lookup

    def run(scene: Scene, images: Any, name: str, uv: NDArray[Any]) -> NDArray[np.float32]:
        textures, texels, index = compile_textures(scene, images)
        out = np.empty((len(uv), 3), np.float32)
        result = device.allocate(out.nbytes)
        buffers = [device.upload(a) for a in (textures, texels, uv.astype(np.float32))]
        device.launch(kernel, [*buffers, np.uint32(index[name]), result], len(uv), 1)
        device.download(result, out)
        return out

    return run


def random_uv(n: int = 20_000, size: float = 3.0) -> NDArray[np.float32]:
    return np.random.default_rng(5).uniform(-size, size, (n, 2)).astype(np.float32)


def fold(x: NDArray[np.float64], wrap: str) -> NDArray[np.float64]:
    """Coordinates in [0, 1] by a triangle or saw-tooth wave, or clamped."""
    if wrap == "clamp":
        return np.clip(x, 0, 1)
    if wrap == "repeat":
        return np.mod(x, 1.0)
    return 1.0 - np.abs(np.mod(x, 2.0) - 1.0)


def reference(
    pixels: NDArray[Any], uv: NDArray[np.float64], wrap: str, bilinear: bool
) -> NDArray[np.float64]:
    """The same lookup in float64, over a padded copy of the image."""
    h, w = pixels.shape[:2]
    mode = "wrap" if wrap == "repeat" else "edge"
    padded = np.pad(pixels.astype(np.float64), ((1, 1), (1, 1), (0, 0)), mode=mode)
    x, y = fold(uv[:, 0], wrap) * w, (1.0 - fold(uv[:, 1], wrap)) * h
    if not bilinear:
        return np.asarray(padded[np.minimum(y.astype(int), h - 1) + 1, np.minimum(x.astype(int), w - 1) + 1])
    x, y = x + 0.5, y + 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    i1, j1 = np.minimum(i + 1, w + 1), np.minimum(j + 1, h + 1)
    top = padded[j, i] * (1 - fx) + padded[j, i1] * fx
    bottom = padded[j1, i] * (1 - fx) + padded[j1, i1] * fx
    return np.asarray(top * (1 - fy) + bottom * fy)


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
@pytest.mark.parametrize("kind", ["nearest", "bilinear"])
def test_images_are_looked_up_as_numpy_would(lookup: Any, kind: str, wrap: str) -> None:
    pixels = picture()
    uv = {"scale": (1.5, -2.0), "offset": (0.25, 0.5)}
    texture = {
        "type": "image",
        "image": {"file": "a"},
        "encoding": "linear",
        "filter": kind,
        "wrap": wrap,
        "uv": uv,
    }
    points = random_uv()
    out = lookup(scene_with(t=texture), Images(a=Image(pixels, True)), "t", points)
    moved = points.astype(np.float64) * uv["scale"] + uv["offset"]
    expected = reference(pixels, moved, wrap, kind == "bilinear")
    # float32 rounding moves a point by 1e-6 of a texel: it may cross an edge between texels.
    wrong = np.abs(out - expected).max(axis=1) > 2e-5
    assert wrong.mean() < (1e-9 if kind == "bilinear" else 1e-4)


def test_the_first_row_is_the_top(lookup: Any) -> None:
    pixels = np.zeros((2, 2, 3), np.float32)
    pixels[0, 1] = 1.0  # top right
    texture = {"type": "image", "image": {"file": "a"}, "encoding": "linear", "filter": "nearest"}
    corners = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])
    out = lookup(scene_with(t=texture), Images(a=Image(pixels, True)), "t", corners)
    np.testing.assert_array_equal(out[:, 0], [0, 0, 0, 1])


def test_checker_squares_have_half_a_unit(lookup: Any) -> None:
    texture = {"type": "checker", "color0": 0.9, "color1": 0.1, "uv": {"scale": (2, 3), "offset": (0.1, 0.2)}}
    uv = random_uv()
    out = lookup(scene_with(t=texture), NoAssets(), "t", uv)[:, 0]
    moved = uv.astype(np.float64) * (2, 3) + (0.1, 0.2)
    square = np.floor(moved * 2.0).astype(int).sum(axis=1) % 2
    wrong = out != np.where(square == 0, np.float32(0.9), np.float32(0.1))
    assert wrong.mean() < 1e-4
    assert out.mean() == pytest.approx(0.5, abs=0.02)


def test_checker_at_edges_of_squares(lookup: Any) -> None:
    texture = {"type": "checker", "color0": 1.0, "color1": 0.0}
    uv = np.array([[0, 0], [0.5, 0], [0, 0.5], [0.5, 0.5], [1, 1], [-0.5, 0], [-1, 0]])
    out = lookup(scene_with(t=texture), NoAssets(), "t", uv)[:, 0]
    np.testing.assert_array_equal(out, [1, 0, 0, 1, 1, 0, 1])


@pytest.mark.parametrize("kind", ["nearest", "bilinear", "checker"])
@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
def test_any_coordinate_gives_a_colour_of_the_texture(lookup: Any, kind: str, wrap: str) -> None:
    values = [
        np.nan,
        np.inf,
        -np.inf,
        3.4e38,
        -3.4e38,
        1e9,
        -1e9,
        2.0**23,
        -(2.0**23) - 1,
        1e-45,
        -1e-9,
        -0.0,
        1.0,
    ]
    uv = np.array(np.meshgrid(values, values), np.float32).reshape(2, -1).T
    pixels = (0.25 + 0.5 * picture()).astype(np.float32)
    if kind == "checker":
        texture: dict[str, Any] = {"type": "checker", "color0": 0.3, "color1": 0.7}
    else:
        texture = {
            "type": "image",
            "image": {"file": "a"},
            "encoding": "linear",
            "filter": kind,
            "wrap": wrap,
        }
    texture["uv"] = {"scale": (1e18, 1.0), "offset": (0.0, 1e18)}
    out = lookup(scene_with(t=texture), Images(a=Image(pixels, True)), "t", uv)
    assert np.isfinite(out).all()
    assert out.min() >= 0.25
    assert out.max() <= 0.75


def test_a_single_texel_is_constant(lookup: Any) -> None:
    for wrap in ("repeat", "mirror", "clamp"):
        texture = {"type": "image", "image": {"file": "a"}, "encoding": "linear", "wrap": wrap}
        image = Image(np.full((1, 1, 3), 0.5, np.float32), True)
        out = lookup(scene_with(t=texture), Images(a=image), "t", random_uv(1000))
        np.testing.assert_allclose(out, 0.5, atol=1e-7)


def test_constant_textures_hold_everywhere(lookup: Any) -> None:
    scene = scene_with(t={"type": "constant", "color": (0.1, 0.2, 0.3)})
    out = lookup(scene, NoAssets(), "t", random_uv(100))
    np.testing.assert_array_equal(out, np.broadcast_to(np.float32([0.1, 0.2, 0.3]), out.shape))


def test_materials_take_their_colours_from_textures_and_stay_within_one(device: Device) -> None:
    scene = Scene.model_validate(
        {
            "version": 1,
            "camera": {"type": "perspective"},
            "textures": {
                "picture": {"type": "image", "image": {"file": "a"}, "encoding": "linear"},
                "squares": {"type": "checker", "color0": 0.9, "color1": 0.2},
            },
            "materials": {
                "leaf": {
                    "type": "diffuse_transmission",
                    "reflectance": {"texture": "picture"},
                    "transmittance": {"texture": "squares"},
                }
            },
        }
    )
    pixels = picture()
    textures, texels, texture_index = compile_textures(scene, Images(a=Image(pixels, True)))
    records, index = compile_materials(scene, texture_index)
    shapes = np.zeros(1, SHAPE)
    shapes["material"] = index["leaf"]
    uv = random_uv(5000)
    out = np.empty((len(uv), 6), np.float32)
    flags = {"PENUMBRA_GLOSS": 0, "PENUMBRA_TRANSMISSION": 1, "PENUMBRA_TEXTURES": 1}
    kernel = device.build("texture_bsdf_test", flags, text=BSDF_KERNEL).colours
    buffers = [device.upload(a) for a in (shapes, records, textures, texels, uv)]
    result = device.allocate(out.nbytes)
    device.launch(kernel, [*buffers, result], len(uv), 1)
    device.download(result, out)
    reflectance = reference(pixels, uv.astype(np.float64), "repeat", bilinear=True)
    square = np.floor(uv.astype(np.float64) * 2.0).astype(int).sum(axis=1) % 2
    transmittance = np.where(square == 0, 0.9, 0.2)[:, None]
    scale = 1.0 / np.maximum(reflectance + transmittance, 1.0)
    np.testing.assert_allclose(out[:, :3], reflectance * scale, atol=2e-5)
    np.testing.assert_allclose(out[:, 3:], transmittance * scale, atol=2e-5)
    assert (scale < 1).any()
    assert (scale == 1).any()


def test_srgb_is_decoded_by_its_two_pieces() -> None:
    # IEC 61966-2-1: linear below .04045, and (x + .055) / 1.055 to the 2.4 above; 8-bit 188 is about half.
    x = np.array([0.0, 0.04, 0.5, 188 / 255, 1.0], np.float32)
    expected = [0.0, 0.04 / 12.92, 0.21404114, 0.50288656, 1.0]
    np.testing.assert_allclose(srgb_to_linear(x), expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("encoding", "eight_bit", "decoded"),
    [("auto", True, True), ("auto", False, False), ("srgb", False, True), ("linear", True, False)],
)
def test_encoding(encoding: str, eight_bit: bool, decoded: bool) -> None:
    pixels = picture()
    scene = scene_with(t={"type": "image", "image": {"file": "a"}, "encoding": encoding})
    _, texels, _ = compile_textures(scene, Images(a=Image(pixels, eight_bit)))
    expected = srgb_to_linear(pixels) if decoded else pixels
    np.testing.assert_array_equal(texels[:, :3], expected.reshape(-1, 3))


def test_each_image_is_decoded_and_stored_once() -> None:
    a = {"type": "image", "image": {"file": "a"}}
    scene = scene_with(
        one=a,
        two={**a, "wrap": "clamp", "filter": "nearest"},
        three={"type": "image", "image": {"file": "b"}},
        four={**a, "encoding": "linear"},
    )
    images = Images(a=Image(picture(), True), b=Image(picture(4, 3), False))
    textures, texels, index = compile_textures(scene, images)
    assert images.decoded == ["a", "b"]
    assert len(texels) == 35 + 12 + 35  # `a` once per encoding
    assert textures["first_texel"][index["one"]] == textures["first_texel"][index["two"]]
    assert textures["first_texel"][index["one"]] != textures["first_texel"][index["four"]]
    assert textures["width"][index["three"]] == 4
    assert textures["height"][index["three"]] == 3


def test_reflectances_are_clipped_so_that_no_surface_makes_light() -> None:
    pixels = np.array([[[-1.0, 0.5, 7.0]]], np.float32)
    _, texels, _ = compile_textures(
        scene_with(t={"type": "image", "image": {"file": "a"}}), Images(a=Image(pixels, False))
    )
    np.testing.assert_array_equal(texels[0, :3], [0.0, 0.5, 1.0])


BROKEN = [
    (np.full((2, 2, 3), np.nan, np.float32), "12 values that are NaN"),
    (np.zeros((0, 4, 3), np.float32), "not empty"),
    (np.zeros((2, 2, 4), np.float32), "accepted is"),
    (np.zeros((1, limits.MAX_TEXTURE_SIDE + 1, 3), np.float32), str(limits.MAX_TEXTURE_SIDE)),
]


@pytest.mark.parametrize(("pixels", "message"), BROKEN)
def test_broken_images_are_refused_with_their_place(pixels: NDArray[Any], message: str) -> None:
    scene = scene_with(wood={"type": "image", "image": {"file": "a"}})
    with pytest.raises(AssetError, match=f"/textures/wood: .*{message}"):
        compile_textures(scene, Images(a=Image(pixels, True)))


def test_missing_images_are_refused_with_their_place() -> None:
    scene = scene_with(wood={"type": "image", "image": {"file": "planks.png"}})
    with pytest.raises(AssetError, match=r"/textures/wood: .*planks\.png"):
        compile_textures(scene, NoAssets())


def test_too_many_texels_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_TEXELS", 40)
    a, b = ({"type": "image", "image": {"file": name}} for name in "ab")
    with pytest.raises(AssetError, match=r"/textures/b: .*accepted are 40"):
        compile_textures(scene_with(a=a, b=b), Images(a=Image(picture(), True), b=Image(picture(), True)))


def test_a_scene_without_textures_has_empty_arrays() -> None:
    textures, texels, index = compile_textures(scene_with(), NoAssets())
    assert (len(textures), texels.shape, index) == (0, (0, 4), {})
