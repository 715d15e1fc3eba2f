"""A quote knows when it does not know: where few pixels carry the pilot's error, there is no upper bound."""

from __future__ import annotations

from typing import Any

import pytest
from penumbra_scene.job import StopReason
from penumbra_scene.quote import Quote
from penumbra_scene.scene import Scene
from penumbra_service.film.allocation import Saving
from penumbra_service.film.predict import Point
from penumbra_service.film.replicates import choose_layout
from penumbra_service.film.stop import MIN_CHECK_SAMPLES
from penumbra_service.jobs.pilot import PilotResult
from penumbra_service.jobs.quote import build_quote
from penumbra_service.web.quotes import quote_view


def quoted(
    stop: dict[str, Any],
    carriers: float,
    *,
    of_few: bool,
    floor: float = 0.0,
    saving: Saving | None = None,
    unsteady: float = 0.05,
) -> Quote:
    adaptive = None if saving is None else {"strategy": "error"}
    scene = Scene.model_validate(
        {"version": 1, "camera": {"type": "perspective"}, "stop": stop, "adaptive": adaptive}
    )
    points = [
        Point(n, n / 50, 1 / n, 1.2 / n, 0.1, 1 / n, carriers, of_few and n == 128, floor)
        for n in (16, 32, 64, 128)
    ]
    found = PilotResult(
        choose_layout(scene.sampler, scene.stop), points, 30, 30, 7680, 2.0, 0.02, rate_deviation=unsteady
    )
    found.saving = saving
    return build_quote(scene, 0.0, found)


def test_what_few_pixels_carry_has_no_upper_bound_and_a_warning() -> None:
    told = quoted({"relative_error": 0.05}, 8.8, of_few=True)
    assert all(row.samples_interval.high is None and row.seconds_interval.high is None for row in told.table)
    assert told.end.samples_interval.high is None
    assert told.end.seconds_interval.high is None
    assert told.end.relative_error_interval is not None
    assert told.end.relative_error_interval.high is None
    assert any("9 pixels" in warning and "at least" in warning for warning in told.warnings)


def test_the_numbers_are_those_that_would_have_a_bound() -> None:
    few, many = (quoted({"relative_error": 0.05}, 8.8, of_few=of_few) for of_few in (True, False))
    assert few.end.samples == many.end.samples
    assert few.end.seconds_interval.low == many.end.seconds_interval.low
    assert (many.end.seconds_interval.high or 0) > many.end.seconds
    assert not any("pixels" in warning for warning in many.warnings)


def test_a_busy_machine_widens_the_seconds_by_equal_factors_and_never_to_none() -> None:
    """A rate that deviates by 80 % of itself says 2.6 times as much, or a 2.6th."""
    steady, busy = (
        quoted({"relative_error": 0.05}, 400.0, of_few=False, unsteady=u).end.seconds_interval
        for u in (0.0, 0.8)
    )
    assert busy.low == pytest.approx(steady.low / 2.568, rel=1e-3)
    assert (busy.high or 0) == pytest.approx((steady.high or 0) * 2.568, rel=1e-3)


def test_a_dark_picture_has_a_warning() -> None:
    dark, plain = (quoted({"relative_error": 0.05}, 900.0, of_few=False, floor=f) for f in (0.75, 0.3))
    assert any("dark" in warning and "75 %" in warning and "2 times" in warning for warning in dark.warnings)
    assert not plain.warnings


def test_spreading_samples_saves_none_of_those_that_an_error_takes_to_be_known() -> None:
    told = quoted({"relative_error": 0.5}, 900.0, of_few=False, saving=Saving(samples=0.1))
    assert told.end.samples == MIN_CHECK_SAMPLES
    assert min(row.samples for row in told.table) >= MIN_CHECK_SAMPLES


@pytest.mark.parametrize("stop", [{"samples": 64}, {"seconds": 10.0}])
def test_samples_and_seconds_that_are_asked_for_are_known_all_the_same(stop: dict[str, Any]) -> None:
    end = quoted(stop, 8.8, of_few=True).end
    assert end.samples_interval.high is not None
    assert end.seconds_interval.high is not None
    assert end.relative_error_interval is not None
    assert end.relative_error_interval.high is None


def test_seconds_end_where_the_clock_does() -> None:
    alone = quoted({"seconds": 10.0}, 400.0, of_few=False).end
    assert (alone.seconds_interval.low, alone.seconds, alone.seconds_interval.high) == (10, 10, 10)
    capped = quoted({"seconds": 10.0, "relative_error": 0.001}, 400.0, of_few=False).end
    assert capped.reason == StopReason.SECONDS
    assert 0 < capped.seconds_interval.low <= capped.seconds == capped.seconds_interval.high == 10


def test_the_page_says_at_least() -> None:
    few, many = (quote_view(quoted({"relative_error": 0.05}, 8.8, of_few=of_few)) for of_few in (True, False))
    assert "at least" in few.summary
    assert all(
        "at least" in row.samples and "at least" in row.seconds and "or more" in row.between
        for row in few.rows
    )
    assert "at least" not in many.summary
    assert all("at least" not in row.samples and " to " in row.between for row in many.rows)
