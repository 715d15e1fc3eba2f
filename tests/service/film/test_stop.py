"""Check points, stop rules, layouts and predictions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from penumbra_scene.settings import Sampler, Stop
from penumbra_service.film.error import ImageError
from penumbra_service.film.predict import THETA_RANGE, Point, fit_fall, fit_theta, predict, upper_at
from penumbra_service.film.replicates import UnknownErrorTargetError, choose_layout
from penumbra_service.film.stop import StopRule, last_end_within, next_check


def _error(relmse: float, deviation: float = 0.0) -> ImageError:
    return ImageError(relmse, deviation, relmse, 20.0, 100)


def test_check_points_are_quarters_of_powers_of_two():
    ends = [0]
    while ends[-1] < 1000:
        ends.append(next_check(ends[-1]))
    expected = {f * 2**k for k in range(10) for f in (4, 5, 6, 7)} | {1, 2, 3}
    assert ends[1:] == sorted(e for e in expected if e <= ends[-1])


def test_without_an_error_rule_check_points_double_up_to_the_end():
    rule = StopRule(8, samples=11)
    ends = [0]
    while (end := rule.next_end(ends[-1])) is not None:
        ends.append(end)
    assert ends == [0, 1, 2, 4, 8, 11]


def test_the_error_rule_demands_the_margin():
    rule = StopRule(8, relative_error=0.1, confidence=0.95)
    assert rule.decide(8, 1.0, _error(0.0099)) == "relative_error"
    assert rule.decide(8, 1.0, _error(0.0099, deviation=0.1)) is None
    assert rule.decide(8, 1.0, _error(0.0099 / (1 + 1.96 * 0.1), deviation=0.1)) == "relative_error"
    strict = StopRule(8, relative_error=0.1, confidence=0.99)
    assert strict.decide(8, 1.0, _error(0.0099 / (1 + 1.96 * 0.1), deviation=0.1)) is None


def test_too_few_samples_never_meet_an_error_target():
    rule = StopRule(8, relative_error=0.1)
    assert rule.decide(1, 1.0, _error(0.0)) is None
    assert rule.decide(2, 1.0, _error(0.0)) == "relative_error"


def test_an_unknown_error_meets_no_target():
    rule = StopRule(8, samples=100, relative_error=0.1)
    assert rule.decide(8, 1.0, ImageError(math.nan, math.nan, math.nan, math.nan, 0)) is None
    assert rule.decide(100, 1.0, None) == "samples"


def test_whichever_rule_comes_first():
    rule = StopRule(8, samples=16, seconds=5.0, relative_error=0.1)
    assert rule.decide(8, 1.0, _error(1.0)) is None
    assert rule.decide(8, 5.0, _error(1.0)) == "seconds"
    assert rule.decide(16, 1.0, _error(1.0)) == "samples"


@pytest.mark.parametrize(
    ("rate", "left", "expected"),
    [
        (10.0, 100.0, 64),
        (10.0, 2.0, 48),
        (10.0, 0.5, 32),
        (10.0, -1.0, 32),
        (math.inf, 1.0, 64),
        (0.0, 1.0, 64),
    ],
)
def test_the_last_batch_fits_the_time_that_is_left(rate, left, expected):  # type: ignore[no-untyped-def]
    assert last_end_within(rate, left, 32, 64) == expected


@pytest.mark.parametrize(
    ("samples", "expected"),
    [(1, (1, 1)), (2, (2, 2)), (3, (2, 4)), (7, (4, 8)), (8, (4, 8)), (9, (4, 12)), (64, (4, 64))],
)
def test_never_more_replicates_than_samples_and_samples_rounded_up(samples, expected):  # type: ignore[no-untyped-def]
    layout = choose_layout(Sampler(), Stop(samples=samples))
    assert (layout.replicates, layout.samples) == expected
    assert layout.strata == layout.samples // layout.replicates


def test_strata_double_where_the_end_is_not_known():
    assert choose_layout(Sampler(), Stop(samples=64, seconds=1.0)).strata == 0
    assert choose_layout(Sampler(), Stop(relative_error=0.1)).strata == 0
    assert choose_layout(Sampler(), Stop(relative_error=0.1)).samples is None


def test_a_deterministic_sampler_takes_one_replicate_and_no_target():
    layout = choose_layout(Sampler(type="regular"), Stop(samples=16))
    assert (layout.replicates, layout.strata, layout.deterministic) == (1, 16, True)
    with pytest.raises(UnknownErrorTargetError, match="regular"):
        choose_layout(Sampler(type="regular"), Stop(relative_error=0.1))
    with pytest.raises(UnknownErrorTargetError, match="2 replicates"):
        choose_layout(Sampler(replicates=1), Stop(relative_error=0.1))


def _points(theta: float, ends: list[int], noise: float = 0.0, seed: int = 0) -> list[Point]:
    rng = np.random.default_rng(seed)
    values = [n**-theta * math.exp(noise * rng.standard_normal()) for n in ends]
    return [Point(n, n / 100, v, v, noise, v) for n, v in zip(ends, values, strict=True)]


@pytest.mark.parametrize("theta", [1.0, 1.2, 1.44])
def test_theta_of_an_exact_power_law(theta):  # type: ignore[no-untyped-def]
    fit = fit_theta(_points(theta, [16, 20, 24, 28, 32, 64, 128]))
    assert fit.theta == pytest.approx(theta)


def test_theta_is_clamped_to_what_paths_can_do():
    ends = [16, 32, 64, 128]
    assert fit_theta(_points(2.85, ends)).theta == THETA_RANGE[1]
    assert fit_theta(_points(0.5, ends)).theta == THETA_RANGE[0]
    assert fit_theta([]).points == 0


def _mixed(share, ends):  # type: ignore[no-untyped-def]
    """Of an error of which a share, at one sample, falls as n^-1.5, and the rest as 1 / n."""
    values = [(1 - share) / n + share * n**-1.5 for n in ends]
    return [Point(n, n / 100, v, 1.5 * v, 0.0) for n, v in zip(ends, values, strict=True)]


@pytest.mark.parametrize("share", [0.0, 0.5, 0.95, 1.0])
def test_samples_and_seconds_to_a_target(share):  # type: ignore[no-untyped-def]
    needed = 3000
    target = math.sqrt(_mixed(share, [needed])[0].upper)
    told = predict(_mixed(share, [16, 20, 24, 28, 32, 40, 48, 56, 64]), target)
    assert told is not None
    assert told.samples == pytest.approx(needed, rel=1e-6)
    assert told.seconds == pytest.approx(told.samples / 100, rel=1e-6)
    assert told.samples_low <= told.samples <= told.samples_high
    assert told.seconds_low <= told.seconds <= told.seconds_high


def test_four_of_five_predictions_are_within_a_factor_of_one_and_a_half():
    """From 128 samples to an error eight times smaller in variance, with 5 % of noise in every point."""
    ends = [16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128]
    hits, covered, n = 0, 0, 200
    for seed in range(n):
        theta = 1 + 0.44 * (seed / n)
        target = math.sqrt(1024**-theta)
        told = predict(_points(theta, ends, 0.05, seed), target)
        assert told is not None
        hits += 1 / 1.5 <= told.samples / 1024 <= 1.5
        covered += told.samples_low <= 1024 <= told.samples_high
    assert hits >= 0.8 * n
    assert covered >= 0.8 * n


@pytest.mark.parametrize("share", [0.0, 0.5, 0.95, 1.0])
def test_what_the_rule_will_compare_falls_as_the_error_does(share):  # type: ignore[no-untyped-def]
    points = _mixed(share, [16, 20, 24, 28, 32])
    assert upper_at(points, 64) == pytest.approx(_mixed(share, [64])[0].upper)
    low, high = fit_fall(points).shares(2.0)
    assert 0 <= low < high <= 1
    assert upper_at([], 64) is None
    assert upper_at([Point(16, 1.0, math.nan, math.nan)], 64) is None


def test_nothing_is_predicted_from_nothing():
    assert predict([], 0.1) is None
    assert predict([Point(8, 1.0, math.nan, math.nan)], 0.1) is None
