"""A target that is out of reach says so early, with numbers that hold."""

from __future__ import annotations

import math

import pytest
from penumbra_scene.job import Shortfall
from penumbra_service.engine.progress import Now, progress_of
from penumbra_service.film.predict import Point
from penumbra_service.film.stop import StopRule
from penumbra_service.jobs.record import RunRecord
from penumbra_service.jobs.shortfall import shortfall

RATE = 10.0
"""Samples a pixel in a second."""


def law(share: float, n: float, start: float = 0.01) -> float:
    """relmse after n samples, of which a share falls as n^-1.5 and the rest as 1 / n."""
    return start * ((1 - share) / n + share * n**-1.5)


def fall(share: float, last: int, start: float = 0.01, deviation: float = 0.02) -> list[Point]:
    """That up to `last` samples."""
    counts = [8 * n for n in (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32) if 8 * n <= last]
    return [
        Point(n, n / RATE, law(share, n, start), law(share, n, start) * (1 + 2 * deviation), deviation)
        for n in counts
    ]


def short(
    points: list[Point], target: float, samples: float | None, seconds: float | None
) -> Shortfall | None:
    return shortfall(points, target, 0.95, samples, seconds)


def test_a_target_within_the_caps_is_no_shortfall() -> None:
    points = fall(0.0, 128)
    target = math.sqrt(0.01 / 1000)
    assert short(points, target, 4000, None) is None
    assert short(points, target, None, 400.0) is None
    assert short(points, target, None, None) is None


@pytest.mark.parametrize("share", [0.0, 0.9, 1.0])
def test_the_numbers_are_those_of_the_law(share: float) -> None:
    points = fall(share, 128)
    needed = 10_000
    target = math.sqrt(law(share, needed))
    told = short(points, target, 512, 1e6)
    assert told is not None
    assert told.cap == "samples"
    assert told.needed_samples == pytest.approx(
        needed, rel=0.06
    )  # the rule asks for relmse with its allowance
    assert told.needed_seconds == pytest.approx(told.needed_samples / RATE, rel=1e-6)
    assert told.expected_error == pytest.approx(math.sqrt(law(share, 512)), rel=0.01)
    assert "the cap is 512 samples" in told.message
    averaged = short(points, target, 512.214, 1e6)  # where pixels differ in theirs
    assert averaged is not None
    assert "the cap is 512 samples" in averaged.message


def test_the_cap_that_comes_first_is_named() -> None:
    points = fall(0.0, 128)
    target = math.sqrt(0.01 / 1e5)
    told = short(points, target, 50_000, 20.0)
    assert told is not None
    assert told.cap == "seconds"
    assert told.expected_error == pytest.approx(math.sqrt(0.01 / 200), rel=0.01)


def test_it_is_said_early_and_not_at_the_first_glance() -> None:
    target = math.sqrt(0.01 / 1e5)
    assert short(fall(0.0, 8), target, 512, None) is None
    assert short(fall(0.0, 16), target, 512, None) is not None


def test_nothing_is_said_while_the_interval_reaches_below_the_cap() -> None:
    target = math.sqrt(0.01 / 600)
    assert short(fall(0.0, 128, deviation=0.3), target, 512, None) is None


def test_a_picture_without_a_known_error_says_nothing() -> None:
    assert short([], 0.1, 64, None) is None
    assert short([*fall(0.0, 64), Point(80, 8.0, math.nan, math.nan)], 1e-9, 128, None) is None


def test_progress_carries_it() -> None:
    record = RunRecord(replicates=8, points=fall(0.0, 64))
    rule = StopRule(8, 16, None, 1e-3)
    told = progress_of(rule, record, None, Now(64, 6.4, 0.1), 0.0).shortfall
    assert told is not None
    assert told.target == 1e-3
