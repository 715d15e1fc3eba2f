"""The pace of a run against sums done by hand."""

from __future__ import annotations

import itertools

import pytest
from penumbra_service.engine.pace import LEAST_WINDOW, Pace


def test_nothing_is_told_before_anything_has_arrived():
    assert Pace().rate is None


def test_it_is_all_samples_over_all_seconds_whatever_single_leases_did():
    """A cheap tile at 9 a second and a dear one at 1 make 1.8 together, not their mean of 5."""
    pace = Pace()
    pace.deliver(1.0, 9.0)
    pace.deliver(10.0, 9.0)
    assert pace.rate == pytest.approx(18 / 10)


def test_waiting_between_deliveries_counts():
    pace = Pace()
    pace.deliver(1.0, 4.0)
    pace.deliver(4.0, 4.0)
    assert pace.rate == pytest.approx(2.0)


def test_a_device_that_has_become_slow_is_seen():
    pace = Pace()
    for second in range(1, 41):
        pace.deliver(float(second), 100.0)
    for second in range(41, 121):
        pace.deliver(float(second), 10.0)
    assert pace.rate == pytest.approx(10.0, rel=0.05)  # the last half of 120 s


def test_a_restart_begins_at_the_pace_of_before_and_forgets_it_smoothly():
    pace = Pace(seconds=100.0, samples=1000.0)
    assert pace.rate == pytest.approx(10.0)
    told = []
    for tenth in range(1, 401):  # a first small lease that took much longer than its share, then 20 a second
        pace.deliver(100.0 + tenth / 10, 2.0 if tenth > 3 else 0.1)
        told.append(pace.rate)
    assert told[0] == pytest.approx((10 * 10 * (1 - 0.1 / LEAST_WINDOW) + 0.1) / (10 * (1 - 0.1 / 30) + 0.1))
    assert all(abs(b / a - 1) < 0.02 for a, b in itertools.pairwise(told))
    assert told[-1] == pytest.approx(20.0, rel=0.02)
