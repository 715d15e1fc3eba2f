"""The contact sheet: where frames stand, which ones, and that thumbnails come back as they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from penumbra_service.images.contact_sheet import (
    BACKGROUND,
    CELL_SIDE,
    GAP,
    LABEL_HEIGHT,
    MAX_CELLS,
    WAITING,
    cell_picture,
    chosen_frames,
    columns_of,
    contact_sheet,
)
from penumbra_service.images.png import read_png, write_png


def test_every_frame_stands_in_its_place_and_missing_ones_are_gray() -> None:
    frames = (1, 2, 5, 9, 12)
    pictures = {f: np.full((40, 80, 3), 10 * f, np.uint8) for f in frames if f != 5}
    sheet = contact_sheet(frames, pictures, (80, 40))
    columns = columns_of(5, 80, 40)
    rows = -(-5 // columns)
    assert sheet.shape == (rows * (40 + LABEL_HEIGHT + GAP) + GAP, columns * (80 + GAP) + GAP, 3)
    for i, frame in enumerate(frames):
        left = GAP + i % columns * (80 + GAP)
        top = GAP + i // columns * (40 + LABEL_HEIGHT + GAP)
        cell = sheet[top : top + 40, left : left + 80]
        assert (cell == (WAITING if frame == 5 else 10 * frame)).all()
        label = sheet[top + 40 : top + 40 + LABEL_HEIGHT, left : left + 80]
        assert (label == 255).any()
        assert (label[0] == BACKGROUND).all()


@pytest.mark.parametrize("size", [(16, 9), (9, 16), (1, 1), (5000, 3), (3, 5000)])
@pytest.mark.parametrize("count", [1, 2, 7, 200])
def test_any_film_and_any_number_of_frames_fit(size: tuple[int, int], count: int) -> None:
    frames = tuple(range(9_999_000, 9_999_000 + count))
    sheet = contact_sheet(frames, {}, size)
    assert sheet.ndim == 3
    assert min(sheet.shape[:2]) >= 1


def test_long_jobs_show_frames_that_lie_evenly_with_both_ends() -> None:
    frames = tuple(range(0, 3000, 3))
    chosen = chosen_frames(frames)
    assert len(chosen) == MAX_CELLS
    assert (chosen[0], chosen[-1]) == (frames[0], frames[-1])
    steps = np.diff([frames.index(frame) for frame in chosen])
    assert set(steps) <= {5, 6}  # 999 / 199 = 5.02
    assert chosen_frames((4, 7)) == (4, 7)


def test_cells_keep_the_mean_and_small_pictures_stay() -> None:
    random = np.random.default_rng(3)
    large = random.integers(0, 256, (320, 640, 3)).astype(np.uint8)
    small = cell_picture(large)
    assert small.shape == (80, CELL_SIDE, 3)
    assert abs(small.mean() - large.mean()) < 0.1
    assert cell_picture(small) is small


def test_a_png_comes_back_as_it_was_written(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, 3)).astype(np.uint8)
    write_png(tmp_path / "a.png", pixels)
    assert (read_png(tmp_path / "a.png") == pixels).all()
    (tmp_path / "b.png").write_bytes(b"no picture")
    for name in ("b.png", "c.png"):
        with pytest.raises(OSError, match=name.split(".")[0]):
            read_png(tmp_path / name)
