"""Leases that two devices do: which, by whom, and who is wrong where they differ."""

from __future__ import annotations

import math

from penumbra_kernels.nodes import Tile
from penumbra_service.jobs.doublecheck import DoubleChecks
from penumbra_service.jobs.planning import WorkItem

ITEMS = (WorkItem(Tile(0, 0, 4, 4), 0, 1),)
A, B, C = ("a", "x"), ("b", "x"), ("c", "x")
OTHER = ("gpu", "y")


def _opened(digest: bytes = b"good") -> DoubleChecks:
    checks = DoubleChecks("job", 0.01)
    checks.open(A, ITEMS, digest)
    return checks


def test_each_devices_first_lease_is_checked_and_the_share_of_the_others():
    checks = DoubleChecks("job", 0.01)
    assert checks.wants("a", 1)
    n = 20_000
    drawn = sum(checks.wants("a", lease) for lease in range(2, n + 2))
    assert abs(drawn - 0.01 * n) < 4.9 * math.sqrt(n * 0.01 * 0.99)
    assert checks.wants("b", 2)


def test_a_share_of_zero_checks_nothing():
    assert not DoubleChecks("job", 0.0).wants("a", 1)


def test_a_lease_is_checked_by_another_device_of_its_bit_class_once():
    checks = _opened()
    assert checks.take(A) is None
    assert checks.take(OTHER) is None
    check = checks.take(B)
    assert check is not None
    assert check.items == ITEMS
    assert checks.take(C) is None
    assert checks.answered(check.number, "b", b"good") == []
    assert checks.done == 1
    assert not checks.pending([A, B, C])


def test_a_third_device_decides():
    for first, second, third, wrong in ((b"good", b"bad", b"good", ["b"]), (b"bad", b"good", b"good", ["a"])):
        checks = _opened(first)
        check = checks.take(B)
        assert check is not None
        assert checks.answered(check.number, "b", second) == []
        assert checks.disputes == [("a", "b")]
        again = checks.take(C)
        assert again is check
        assert checks.answered(check.number, "c", third) == wrong
        assert checks.disputes == []


def test_three_different_answers_need_a_fourth():
    checks = _opened()
    for device, digest in ((B, b"bad"), (C, b"worse")):
        check = checks.take(device)
        assert check is not None
        assert checks.answered(check.number, device[0], digest) == []
    check = checks.take(("d", "x"))
    assert check is not None
    assert checks.answered(check.number, "d", b"good") == ["b", "c"]


def test_a_check_that_is_lost_goes_to_another():
    checks = _opened()
    check = checks.take(B)
    assert check is not None
    assert checks.pending([A, B])
    checks.lost(check.number)
    assert checks.take(C) is check
    assert not checks.pending([A])


def test_answers_of_a_device_that_is_not_believed_are_void():
    checks = _opened()
    checks.forget("a")
    assert not checks.pending([A, B, C])
    assert checks.take(B) is None
