"""Thumbnails and noise maps: the numbers behind the colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from penumbra_service.images.digits import draw_text
from penumbra_service.images.heatmap import (
    HIGHEST,
    LOWEST,
    SCALE_HEIGHT,
    UNKNOWN,
    heatmap,
    palette,
    relative_error,
    write_heatmap,
)
from penumbra_service.images.resize import fitted_size, shrink
from penumbra_service.images.thumbnail import thumbnail, write_thumbnail


def gray(value: float, height: int = 8, width: int = 12) -> np.ndarray:
    return np.full((height, width, 3), value, np.float32)


@pytest.mark.parametrize(
    ("linear", "code"),
    # IEC 61966-2-1: 0.18 -> 0.46135613, 0.5 -> 0.73535698, 0.001 -> 0.01292
    [
        (0.0, 0),
        (1.0, 255),
        (2.0, 255),
        (0.18, 118),
        (0.5, 188),
        (0.001, 3),
        (-1.0, 0),
        (np.nan, 0),
        (np.inf, 255),
    ],
)
def test_srgb_codes(linear: float, code: int) -> None:
    assert (thumbnail(gray(linear)) == code).all()


def test_exposure_is_in_stops() -> None:
    assert (thumbnail(gray(0.125), exposure=2.0) == thumbnail(gray(0.5))).all()
    assert (thumbnail(gray(1e-9), exposure=32.0) == 255).all()
    assert (thumbnail(gray(1e30), exposure=-32.0) == 255).all()


def test_the_aces_view_is_that_of_aces_1() -> None:
    """Scene-referred mid-gray 0.18 is shown at 10 % of white (ACES 1.x output transforms: 4.8 of 48 nits)."""
    code = thumbnail(gray(0.18), view="aces")[0, 0].astype(float) / 255
    shown = ((code + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(shown, 0.1, atol=0.006)
    assert (thumbnail(gray(0.0), view="aces") == 0).all()
    steps = [int(thumbnail(gray(v), view="aces")[0, 0, 1]) for v in (0.05, 0.2, 1.0, 4.0, 16.0)]
    assert steps == sorted(set(steps))
    assert steps[-2] < 255


@pytest.mark.parametrize(
    ("width", "height", "side"), [(512, 512, 512), (4096, 16, 512), (3, 7000, 16), (100, 50, 99)]
)
def test_a_thumbnail_is_never_larger_than_asked(width: int, height: int, side: int) -> None:
    w, h = fitted_size(width, height, side)
    assert 1 <= w <= min(width, side)
    assert 1 <= h <= min(height, side)
    assert thumbnail(gray(0.5, height, width), max_side=side).shape == (h, w, 3)


def test_small_pictures_are_not_blown_up() -> None:
    assert thumbnail(gray(0.5, 4, 6), max_side=512).shape == (4, 6, 3)


def test_shrinking_keeps_the_mean_and_covers_by_area() -> None:
    pixels = np.random.default_rng(2).random((37, 53, 3)).astype(np.float32)
    small = shrink(pixels, 17)
    np.testing.assert_allclose(small.mean(axis=(0, 1)), pixels.mean(axis=(0, 1)), rtol=1e-4)
    row = np.array([[[1.0], [2.0], [6.0]]], np.float32)
    # cells of 1.5: (1 + 2/2) / 1.5 and (2/2 + 6) / 1.5
    np.testing.assert_allclose(shrink(row, 2)[0, :, 0], [2 / 1.5, 7 / 1.5], rtol=1e-6)


def test_png_files_can_be_read_back(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    picture = np.random.default_rng(3).random((40, 60, 3)).astype(np.float32)
    write_thumbnail(path, picture)
    read = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
    np.testing.assert_array_equal(read, thumbnail(picture))
    assert [file.name for file in tmp_path.iterdir()] == ["a.png"]


def test_relative_error_is_that_of_the_stop_rule() -> None:
    error = relative_error(gray(2.0), gray(0.04))
    np.testing.assert_allclose(error, np.sqrt(0.04 / (4.0 + 0.01)), rtol=1e-6)


def test_the_map_has_a_fixed_scale_and_says_what_is_unknown() -> None:
    mean, variance = gray(1.0, 100, 200), gray(0.0, 100, 200)
    variance[:, 100:] = np.nan
    picture = heatmap(mean, variance)
    assert picture.shape == (100 + SCALE_HEIGHT, 200, 3)
    assert (picture[:100, :100] == palette(np.array(0.0))).all()
    assert (picture[:100, 100:] == UNKNOWN).all()
    for error, position in ((LOWEST, 0.0), (np.sqrt(LOWEST * HIGHEST), 0.5), (HIGHEST, 1.0), (50.0, 1.0)):
        shown = heatmap(mean, gray(error**2 * 1.01, 100, 200))[50, 50].astype(int)
        np.testing.assert_allclose(shown, palette(np.array(position)).astype(int), atol=1)


@pytest.mark.parametrize("width", [96, 97, 320, 512])
def test_labels_are_whole_and_off_the_edges(width: int) -> None:
    labels = heatmap(gray(1.0, 60, width), gray(0.1, 60, width))[-SCALE_HEIGHT + 11 :]
    lit = (labels == 255).all(axis=-1)
    assert not lit[:, :3].any()
    assert not lit[:, -3:].any()
    assert not lit[-1].any()
    alone = np.zeros((4, 8, 100, 3), np.uint8)
    for canvas, label in zip(alone, ("0.1%", "1%", "10%", "100%"), strict=True):
        draw_text(canvas, label, 50, 1)
    assert lit.sum() == (alone[..., 0] == 255).sum()  # nothing is cut off, nothing overlaps


def test_the_palette_gets_lighter_all_the_way() -> None:
    codes = palette(np.linspace(0, 1, 64)).astype(float) / 255
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > 0).all()


@pytest.mark.parametrize("side", [16, 64, 128, 512])
def test_a_map_is_never_larger_than_asked(tmp_path: Path, side: int) -> None:
    write_heatmap(tmp_path / "h.png", gray(1.0, 300, 200), gray(0.1, 300, 200), max_side=side)
    shape = oiio.ImageBuf(str(tmp_path / "h.png")).get_pixels(oiio.UINT8).shape
    assert max(shape[:2]) <= side
