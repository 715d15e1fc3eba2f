"""A receipt's map says what the render's own map says, and nothing else is taken for one."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile
from penumbra_service.film.allocation import BLOCK
from penumbra_service.film.levels import LevelMap, spread
from penumbra_service.jobs.sample_map import levels_of, sample_map

WINDOW = Tile(13, 7, 40, 33)
"""Its edges cut blocks of 2: 21 columns and 17 rows of them are touched."""


def _levels(*, by_block: bool) -> LevelMap:
    rng = np.random.default_rng(3)
    values = rng.integers(0, 5, (17, 21) if by_block else (33, 40), np.uint8)
    return LevelMap(
        WINDOW,
        spread(values, WINDOW, BLOCK) if by_block else values,
        kept=4,
        kept_planned=16,
        shadow_rays=2,
        kept_shadow_rays=(1, 5),
    )


@pytest.mark.parametrize("by_block", [True, False])
def test_a_map_comes_back_from_its_receipt(by_block: bool) -> None:
    levels = _levels(by_block=by_block)
    told = sample_map(levels)
    assert told is not None
    assert (told.block, told.rows, told.columns) == ((2, 17, 21) if by_block else (1, 33, 40))
    back = levels_of(told, WINDOW)
    assert back.levels is not None
    assert np.array_equal(back.levels, levels.levels)
    assert (back.kept, back.kept_planned) == (4, 16)
    assert (back.shadow_rays, back.kept_shadow_rays) == (2, (1, 5))


def test_an_even_picture_has_none() -> None:
    assert sample_map(LevelMap(WINDOW)) is None


def test_a_map_of_another_window_and_a_broken_one_are_refused() -> None:
    told = sample_map(_levels(by_block=True))
    assert told is not None
    with pytest.raises(ValueError, match="17 x 21 blocks, where the picture has 20 x 20"):
        levels_of(told, Tile(0, 0, 40, 40))
    for size in (356, 358, 10_000_000):
        text = base64.b64encode(zlib.compress(bytes(size))).decode()
        with pytest.raises(ValueError, match="357 blocks"):
            levels_of(told.model_copy(update={"levels": text}), WINDOW)
    with pytest.raises(ValueError, match="base64"):
        levels_of(told.model_copy(update={"levels": "not base64!"}), WINDOW)
