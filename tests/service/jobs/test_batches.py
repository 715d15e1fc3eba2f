"""Batches: one ahead and never two, nothing past the stop counts, time is used and kept."""

from __future__ import annotations

from itertools import pairwise

from penumbra_service.film.error import ImageError
from penumbra_service.film.stop import StopRule
from penumbra_service.jobs.batches import Batches

BAD = ImageError(1.0, 0.0, 1.0, 1.0, 1)
GOOD = ImageError(1e-9, 0.0, 1.0, 1.0, 1)


def test_one_batch_is_worked_on_ahead_and_never_two():
    batches = Batches(StopRule(8, relative_error=0.01))
    assert batches.open_next(None, None) == (0, 1)
    assert batches.open_next(None, None) == (1, 2)
    assert batches.open_next(None, None) is None
    assert batches.barriers == (1,)
    assert batches.check(0.1, BAD) is None
    assert (batches.checked, batches.current, batches.ahead) == (1, 2, None)
    assert batches.barriers == (1, 2)
    assert batches.open_next(None, None) == (2, 4)  # far from the error


def ends_of(relmse, target, early=True):  # type: ignore[no-untyped-def]
    """All check points of a job whose relmse is a function of its samples a pixel; the batch ahead is begun before the look
    (early) or after it."""
    batches = Batches(StopRule(4, relative_error=target))
    while True:
        batches.open_next(None, None)
        if early:
            batches.open_next(None, None)
        found = relmse(4 * batches.current)
        if batches.check(0.0, ImageError(found, 0.0, found, 1.0, 1)):
            return batches.ends


def test_looks_that_cannot_end_a_render_are_left_out_however_fast_it_is():
    """A relmse of 1 / samples that meets its target at 320 samples, and at 20."""
    for early in (True, False):
        assert ends_of(lambda n: 1 / n, 319.5**-0.5, early) == [1, 4, 8, 16, 32, 40, 56, 64, 80]
        assert ends_of(lambda n: 1 / n, 19.5**-0.5, early) == [1, 4, 5]


def test_an_error_that_falls_as_fast_as_any_is_not_looked_for_too_late():
    points = [f * 2**k for k in range(2, 10) for f in (4, 5, 6, 7)]
    for theta in (1.0, 1.25, 1.5):
        for needed in (20, 24, 40, 56, 64, 100, 333, 1000):
            met = ends_of(lambda n, needed=needed, theta=theta: (needed / n) ** theta * 1e-4, 0.01)[-1]
            assert 4 * met == min(n for n in points if n >= needed)


def test_a_picture_is_looked_at_once_in_an_octave_at_least():
    ends = ends_of(lambda n: 1 / n, 1e5**-0.5)
    assert all(after <= 2 * end for end, after in pairwise(ends[1:]))


def test_what_is_past_the_stop_does_not_count():
    batches = Batches(StopRule(8, relative_error=0.01))
    batches.open_next(None, None)
    batches.open_next(None, None)
    batches.check(0.1, BAD)
    batches.open_next(None, None)
    assert batches.check(0.2, GOOD) == "relative_error"
    assert batches.settle() == 2
    assert batches.ends == [1, 2]


def test_speed_chooses_check_points_only_where_they_decide_nothing():
    free = Batches(StopRule(8, samples=1000))
    assert free.open_next(100.0, None) == (0, 64)
    costly = Batches(StopRule(8, samples=1000))
    assert costly.open_next(100.0, None, look_seconds=0.2) == (0, 256)
    bound = Batches(StopRule(8, samples=1000, relative_error=0.01))
    assert bound.open_next(100.0, None) == (0, 1)


def test_no_check_point_of_a_pilot_is_left_out():
    """What it decides depends on all of them: speed may not choose."""
    batches = Batches(StopRule(8, samples=64, deciding=True))
    assert [batches.open_next(1e9, None) for _ in range(2)] == [(0, 1), (1, 2)]


def test_time_left_shortens_the_batch_and_ends_the_job():
    batches = Batches(StopRule(8, seconds=10.0), checked=64)
    left = batches.seconds_left(9.5, 0.0, 16.0)
    assert left == 0.5
    assert batches.open_next(16.0, left) == (64, 72)
    assert batches.seconds_left(9.75, 4.0, 16.0) == 0.0
    assert batches.open_next(16.0, 0.0) is None
    assert batches.check(10.0, BAD) == "seconds"
    assert batches.settle() == 72


def test_a_first_picture_is_always_finished():
    batches = Batches(StopRule(8, seconds=1.0))
    batches.open_next(None, 1.0)
    assert not batches.overdue(100.0, lambda: 100.0)
    batches.checked = 1
    assert batches.overdue(1.0, lambda: 0.2)
    assert not batches.overdue(1.0, lambda: 0.04)
    assert not batches.overdue(0.9, lambda: 100.0)


def test_begun_batches_are_taken_up_again():
    batches = Batches(StopRule(8, relative_error=0.01), checked=4)
    batches.reopen((5, 6))
    assert batches.ranges == [(0, 4), (4, 5), (5, 6)]
    assert batches.open_ends == (5, 6)
    assert batches.barriers == (4, 5)
    assert Batches(StopRule(8)).ranges == []


def test_whether_another_batch_follows_is_known_where_no_error_decides():
    by_samples = Batches(StopRule(8, samples=64))
    opened = [by_samples.open_next(None, None) for _ in range(2)]
    assert opened == [(0, 1), (1, 2)]
    assert by_samples.more_follows(None, None)
    assert not Batches(StopRule(8, samples=64), checked=32, current=64).more_follows(None, None)
    assert not Batches(StopRule(8, samples=64, relative_error=0.01), current=1).more_follows(None, None)
    assert not Batches(StopRule(8, samples=64, deciding=True), current=1).more_follows(None, None)


def test_another_batch_follows_where_it_fits_the_seconds_that_are_left():
    batches = Batches(StopRule(8, seconds=10.0), checked=64, current=80)
    assert batches.more_follows(16.0, 1.5)  # half a second for 8 of the next 16, after 16
    assert not batches.more_follows(16.0, 1.2)
    assert not batches.more_follows(None, 100.0)
