"""Ranges of frames as people write them."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from penumbra_scene.frames import FramesError, is_range, parse_frames
from penumbra_scene.limits import MAX_FRAMES
from penumbra_scene.parse import job_from_json


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("12", (12,)),
        ("0", (0,)),
        ("1-4", (1, 2, 3, 4)),
        ("1-9x4", (1, 5, 9)),
        ("1-8x4", (1, 5)),
        ("9,1,5", (1, 5, 9)),
        ("1-3,2-5", (1, 2, 3, 4, 5)),
        ("7-7", (7,)),
        ("007", (7,)),
    ],
)
def test_frames_are_those_that_the_text_means(text: str, frames: tuple[int, ...]) -> None:
    assert parse_frames(text) == frames


@settings(max_examples=200, deadline=None, derandomize=True)
@given(numbers=st.sets(st.integers(0, 9999), min_size=1, max_size=50))
def test_a_list_of_numbers_is_read_back_in_order_and_each_once(numbers: set[int]) -> None:
    text = ",".join(str(number) for number in [*numbers, *numbers])
    assert parse_frames(text) == tuple(sorted(numbers))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("5-1", "ends before it begins"),
        ("1-5x0", "step of at least 1"),
        (f"0-{MAX_FRAMES}", f"more than {MAX_FRAMES}"),
        ("0-5999,10000-15999", f"more than {MAX_FRAMES}"),
        ("x", "no frame and no range"),
        ("", "no frame and no range"),
    ],
)
def test_what_means_no_frames_says_which_part(text: str, what: str) -> None:
    with pytest.raises(FramesError, match=what):
        parse_frames(text)


def test_the_largest_range_is_accepted() -> None:
    assert len(parse_frames(f"1-{MAX_FRAMES}")) == MAX_FRAMES


def test_a_lone_number_is_one_picture_and_anything_else_a_sequence(minimal: dict[str, Any]) -> None:
    assert not is_range("12")
    assert job_from_json({"scene": minimal, "frames": "12"}).sequence == ()
    assert job_from_json({"scene": minimal}).sequence == ()
    job = job_from_json({"scene": minimal, "frames": "12-12", "fps": 48})
    assert job.sequence == (12,)
    assert job.time == job.time_of(12) == 0.25
