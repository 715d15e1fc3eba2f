"""The preview is the picture averaged over squares, whatever the tiles."""

from __future__ import annotations

import numpy as np
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sums import no_sums
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.preview import Preview
from penumbra_service.film.statistics import pixel_statistics

WINDOW = Tile(5, 3, 60, 40)


def _put(preview, picture, tile):  # type: ignore[no-untyped-def]
    part = picture[:, tile.y - WINDOW.y :, tile.x - WINDOW.x :][:, : tile.height, : tile.width]
    sums = no_sums(part.shape[:3])
    sums["rgba"] = part
    sums["taken"] = 1
    preview.put(pixel_statistics(tile, sums))


def test_a_preview_averages_squares_of_the_full_frame():
    rng = np.random.default_rng(1)
    picture = rng.random((4, WINDOW.height, WINDOW.width, 4)).astype(np.float32)
    images = []
    for size in (16, 32):
        preview = Preview(WINDOW, max_side=16)
        assert preview.scale == 4
        for tile in TileGrid(WINDOW, size):
            _put(preview, picture, tile)
        assert preview.changed
        images.append(preview.image())
        assert not preview.changed
    assert np.array_equal(images[0].rgba, images[1].rgba)
    image = images[0]
    assert image.rgba.shape == (11, 16, 4)  # squares 0-10 (rows 3-42) and 1-16 (columns 5-64)
    mean = picture.mean(axis=0)
    np.testing.assert_allclose(image.rgba[1, 1], mean[1:5, 3:7].mean(axis=(0, 1)), rtol=1e-5)
    np.testing.assert_allclose(image.rgba[0, 0], mean[:1, :3].mean(axis=(0, 1)), rtol=1e-5)
    v = picture.var(axis=0, ddof=1) / 4
    np.testing.assert_allclose(image.variance[1, 1], v[1:5, 3:7, :3].sum(axis=(0, 1)) / 16**2, rtol=1e-4)


def test_a_small_window_is_shown_as_it_is():
    assert Preview(Tile(0, 0, 100, 50)).scale == 1
    assert Preview(Tile(0, 0, 3840, 2160)).scale == 4
