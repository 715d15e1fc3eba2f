"""What a running job says of the seconds that it still takes."""

from __future__ import annotations

import pytest
from penumbra_scene.job import Progress, ProgressEvent
from penumbra_service.engine.progress import Now, forecast, progress_of
from penumbra_service.film.predict import Point
from penumbra_service.film.stop import StopRule
from penumbra_service.jobs.record import RunRecord

NOW = Now(64.0, 6.4, 0.1)


def told(rule: StopRule, *, of_few: bool) -> Progress:
    """Of a job that has seen a relmse of 1 / samples up to 64, a sample in a tenth of a second."""
    points = [
        Point(n, n / 10, 1 / n, 1.1 / n, 0.05, of_few=of_few) for n in (16, 20, 24, 28, 32, 40, 48, 56, 64)
    ]
    record = RunRecord(replicates=4, points=points)
    return progress_of(rule, record, forecast(rule, points, NOW), NOW, 0.0)


def test_the_interval_holds_what_is_predicted() -> None:
    progress = told(StopRule(4, relative_error=0.05), of_few=False)
    interval = progress.predicted_seconds_interval
    assert interval is not None
    assert interval.high is not None
    assert progress.predicted_seconds is not None
    assert interval.low < progress.predicted_seconds < interval.high
    assert progress.predicted_seconds == pytest.approx((1.1 * 400 - 64) / 10)


def test_what_few_pixels_carry_has_no_upper_end() -> None:
    few, many = (told(StopRule(4, relative_error=0.05), of_few=of_few) for of_few in (True, False))
    assert few.predicted_seconds == many.predicted_seconds
    assert few.predicted_seconds_interval is not None
    assert few.predicted_seconds_interval.high is None


def test_a_cap_is_an_upper_end_all_the_same() -> None:
    for cap in (StopRule(4, 200, relative_error=0.05), StopRule(4, seconds=80.0, relative_error=0.05)):
        interval = told(cap, of_few=True).predicted_seconds_interval
        assert interval is not None
        assert interval.high == pytest.approx(73.6)


def test_a_cap_alone_has_no_interval() -> None:
    """How the devices' rate will vary is not known, and one of no width would say that it is."""
    for cap in (StopRule(4, 200), StopRule(4, seconds=80.0)):
        progress = told(cap, of_few=True)
        assert progress.predicted_seconds == pytest.approx(73.6)
        assert progress.predicted_seconds_interval is None


def test_command_line_and_page_say_at_least() -> None:
    from penumbra_client.cli.progress import _numbers
    from penumbra_service.web.pages import to_go

    for of_few, said in ((True, True), (False, False)):
        progress = told(StopRule(4, relative_error=0.05), of_few=of_few)
        event = ProgressEvent(id="j" * 22, state="rendering", **progress.model_dump())
        assert ("at least" in _numbers(event)) is said
        assert to_go(progress).startswith("at least") is said
        assert ("–" in to_go(progress)) is not said
