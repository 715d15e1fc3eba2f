"""PNG files, read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from numpy.typing import NDArray
from penumbra_service.images.png import read_png, write_png


def noise(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(1).integers(0, 256, (height, width, 3), np.uint8)


def ramps(height: int, width: int) -> NDArray[np.uint8]:
    """Along x, along y and along both."""
    y, x = np.mgrid[:height, :width]
    picture = np.stack([x * 3, y * 5, x * 2 + y], -1)
    picture[height // 2 :] = 77
    return picture.astype(np.uint8)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 1), (33, 65), (128, 31)])
@pytest.mark.parametrize("make", [noise, ramps])
def test_the_same_pixels_come_back(make: object, size: tuple[int, int], tmp_path: Path) -> None:
    pixels = make(*size)  # type: ignore[operator]
    write_png(tmp_path / "p.png", pixels)
    assert np.array_equal(read_png(tmp_path / "p.png"), pixels)
    assert [file.name for file in tmp_path.iterdir()] == ["p.png"]


def test_it_is_taken_for_srgb_and_says_what_it_shows(tmp_path: Path) -> None:
    write_png(tmp_path / "p.png", noise(4, 4), {"Description": "exposure 1 stops"})
    reader = oiio.ImageInput.open(str(tmp_path / "p.png"))
    spec = reader.spec()
    assert "srgb" in spec.get_string_attribute("oiio:ColorSpace").lower()
    assert spec.get_string_attribute("ImageDescription") == "exposure 1 stops"
    reader.close()


def test_a_folder_that_is_not_there_is_an_error_and_nothing_is_left(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        write_png(tmp_path / "missing" / "p.png", noise(2, 2))
    assert not list(tmp_path.iterdir())
