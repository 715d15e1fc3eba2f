"""The pages' pure parts: lines of pointers, the plot's geometry, numbers in words."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from penumbra_scene.errors import pointer
from penumbra_scene.job import ErrorPoint
from penumbra_service.web import plot, words
from penumbra_service.web.locate import line_of

LEAVES = st.none() | st.booleans() | st.integers() | st.text(max_size=5)
DOCUMENTS = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
)
MARK = "the place that is looked for"


def places(document: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = (
        document.items()
        if isinstance(document, dict)
        else enumerate(document)
        if isinstance(document, list)
        else ()
    )
    return [path, *(place for key, value in items for place in places(value, (*path, key)))]


def marked(document: Any, path: tuple[str | int, ...]) -> Any:
    """The document with the mark at a place."""
    if not path:
        return MARK
    copy = dict(document) if isinstance(document, dict) else list(document)
    copy[path[0]] = marked(copy[path[0]], path[1:])
    return copy


@settings(max_examples=200, deadline=None, derandomize=True)
@given(document=DOCUMENTS, data=st.data(), indent=st.sampled_from([None, 0, 2]))
def test_a_pointer_is_found_on_the_line_where_its_value_stands(
    document: Any, data: st.DataObject, indent: int | None
) -> None:
    path = data.draw(st.sampled_from(places(document)))
    text = json.dumps(marked(document, path), indent=indent)
    expected = next(n for n, line in enumerate(text.split("\n"), 1) if MARK in line)
    assert line_of(text, pointer(path)) == expected


@pytest.mark.parametrize(
    ("text", "at", "line"),
    [
        ('{"a": 1,\n "b": {\n  "c": 2}}', "/b/missing", 2),
        ('{"a": [1,\n 2]}', "/a/7", 1),
        ('{"a": [1,\n 2]}', "/a/1/x", 2),
        ("\n\n{}", "", 3),
        ("", "", None),
        ("{", "/a", None),
        ('{"a" 1}', "/b", None),
        ("nonsense", "/a", 1),
    ],
)
def test_what_is_missing_is_found_at_its_parent_and_nonsense_nowhere(
    text: str, at: str, line: int | None
) -> None:
    assert line_of(text, at) == line


def power_law(theta: float, count: int = 6) -> list[ErrorPoint]:
    """Points whose variance falls as samples^-theta, at 100 samples a second."""
    samples = [16.0 * 2**i for i in range(count)]
    return [
        ErrorPoint(
            samples=n, seconds=n / 100, relmse=0.01 * n**-theta, relative_error=0.1 * n ** (-theta / 2)
        )
        for n in samples
    ]


@pytest.mark.parametrize("over", ["samples", "seconds"])
def test_a_power_law_is_a_straight_line(over: str) -> None:
    drawn = plot.error_plot(power_law(1.3), over)
    assert drawn is not None
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(drawn.dots)]
    assert slopes == pytest.approx([slopes[0]] * len(slopes), rel=2e-3)
    assert slopes[0] > 0  # y grows downwards: the error falls


def test_the_forecast_goes_on_along_the_line_until_the_target() -> None:
    points = power_law(1.0, 4)
    drawn = plot.error_plot(points, "samples", target=0.0025, theta=1.0)
    assert drawn is not None
    assert drawn.target is not None
    (x0, y0), (x1, y1) = ([float(v) for v in p.split(",")] for p in drawn.forecast.split(" "))
    assert (x0, y0) == drawn.dots[-1]
    assert y1 == drawn.target
    (ax, ay), (bx, by) = drawn.dots[0], drawn.dots[-1]
    assert (y1 - y0) / (x1 - x0) == pytest.approx((by - ay) / (bx - ax), rel=1e-2)
    # the last point has 128 samples; a quarter of its error needs sixteen times as many
    last = points[-1].relative_error
    assert last is not None
    wanted = 128 * (last / 0.0025) ** 2
    share = (x1 - bx) / (bx - ax)
    assert share == pytest.approx(math.log(wanted / 128) / math.log(8), rel=1e-2)


def test_everything_is_drawn_inside_the_frame() -> None:
    drawn = plot.error_plot(power_law(1.1), "seconds", target=1e-4, theta=1.1)
    assert drawn is not None
    for x, y in drawn.dots:
        assert plot.LEFT <= x <= plot.WIDTH - plot.RIGHT
        assert plot.TOP <= y <= plot.HEIGHT - plot.BOTTOM
    for ticks in (drawn.x_ticks, drawn.y_ticks):
        assert 2 <= len(ticks) <= 6
        assert len({tick.label for tick in ticks}) == len(ticks)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_points_are_no_plot(count: int) -> None:
    assert plot.error_plot(power_law(1.0, count), "samples") is None


def test_points_without_an_error_are_left_out() -> None:
    unknown = ErrorPoint(samples=8, seconds=0, relmse=None, relative_error=None)
    drawn = plot.error_plot([unknown, *power_law(1.0, 3)], "seconds")
    assert drawn is not None
    assert len(drawn.dots) == 3


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (None, "–"),
        (0, "0 %"),
        (0.5, "50.0 %"),
        (0.0123, "1.2 %"),
        (0.00123, "0.12 %"),
        (1e-5, "0.001 %"),
        (1e-6, "1.0e-04 %"),
        (12, "1200 %"),
    ],
)
def test_percentages(share: float | None, text: str) -> None:
    assert words.percent(share) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "–"),
        (0.004, "4 ms"),
        (0.25, "0.2 s"),
        (9.94, "9.9 s"),
        (59.4, "59 s"),
        (59.6, "1 min"),
        (75.3, "1 min 15 s"),
        (3600, "1 h"),
        (7260, "2 h 1 min"),
        (90000, "1 d 1 h"),
        (1e9, "31.7 years"),
        (1e12, "31\u202f700 years"),
        (1e15, "31.7 million years"),
    ],
)
def test_durations(seconds: float | None, text: str) -> None:
    assert words.duration(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.02, "20 ms"),
        (5.0, "5.0 s"),
        (200.0, "200 s"),
        (20000.0, "333 min"),
        (2e5, "55.6 h"),
        (1e7, "116 d"),
        (1e11, "3\u202f170 years"),
    ],
)
def test_durations_under_an_axis_have_one_unit(seconds: float, text: str) -> None:
    assert words.brief(seconds) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [(None, "–"), (0, "0"), (88.25, "88.2"), (1234567, "1\u202f234\u202f567"), (1.5e13, "1.50 × 10¹³")],
)
def test_counts(number: float | None, text: str) -> None:
    assert words.count(number) == text


@pytest.mark.parametrize(
    ("number", "text"), [(0, "0 B"), (999, "999 B"), (3_100_000, "3.1 MB"), (8 << 30, "8.59 GB")]
)
def test_sizes(number: int, text: str) -> None:
    assert words.size(number) == text
