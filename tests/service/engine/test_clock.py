"""Seconds of tracing: only while a lease is under way, from the first loaded scene on."""

from __future__ import annotations

import pytest
from penumbra_service.engine.clock import TraceClock


@pytest.fixture
def at(monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    """at(t): what the machine's clock shows from now on."""
    now = [0.0]
    monkeypatch.setattr("penumbra_service.engine.clock.time.monotonic", lambda: now[0])
    return lambda t: now.__setitem__(0, t)


def test_a_clock_runs_while_it_is_started_and_busy(at) -> None:  # type: ignore[no-untyped-def]
    clock = TraceClock(5.0)
    clock.busy(True)
    at(10)
    assert clock.seconds == 5.0  # the scene is still being loaded
    clock.start()
    at(11)
    clock.start()
    clock.busy(True)
    at(12)
    assert clock.seconds == 7.0
    clock.busy(False)  # others have the devices
    at(20)
    assert clock.seconds == 7.0
    clock.busy(True)
    at(21)
    assert clock.seconds == 8.0
    clock.stop()
    at(30)
    clock.busy(True)
    assert clock.seconds == 8.0
