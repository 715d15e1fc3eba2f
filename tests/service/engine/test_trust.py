"""Devices that fail are counted over all frames of a job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest
from penumbra_kernels.nodes import Tile
from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.protocol import DeviceDescription, LeaseResult, RenderSpec
from penumbra_service.engine.standing import Standing
from penumbra_service.engine.task import RunFailedError
from penumbra_service.engine.trust import Trust
from penumbra_service.jobs.planning import WorkItem
from penumbra_service.jobs.record import RunRecord

GOOD, WEAK = (
    DeviceDescription(name, name, "Fake", "1.0", "1.0", "cpu", 1, 1 << 30, "fake")
    for name in ("good", "weak")
)


@dataclass
class Frame:
    """What one frame's run has."""

    record: RunRecord
    desk: LeaseDesk
    trust: Trust


@pytest.fixture
def make_frame() -> Callable[..., Frame]:
    """make_frame(standing, name, record, devices)"""

    def make(
        standing: Standing,
        name: str,
        record: RunRecord | None = None,
        devices: tuple[DeviceDescription, ...] = (GOOD, WEAK),
    ) -> Frame:
        spec = RenderSpec("scene.json", "h", None, None, 0.0, 4, 0)
        desk = LeaseDesk("job", spec, hungry=lambda: None, barred=standing.blocked, name=name)
        desk.add([WorkItem(Tile(0, 0, 64, 64), 0, 64)])
        record = record or RunRecord()
        return Frame(record, desk, Trust(record, desk, lambda: devices, standing, name))

    return make


def test_the_third_failure_of_a_device_blocks_it_in_whatever_frame(make_frame):  # type: ignore[no-untyped-def]
    standing = Standing()
    first, second = make_frame(standing, "job/1"), make_frame(standing, "job/2")
    for frame in (first, second):
        frame.trust.failed(WEAK, "it refuses", ["weak"])
        assert frame.desk.next_lease(WEAK) is not None
    second.trust.failed(WEAK, "it refuses", ["weak"])
    assert [use.blocked for use in second.record.devices.values()] == ["failures"]
    assert "device weak was left out after 3 failures: it refuses" in second.record.warnings
    third = make_frame(standing, "job/3")
    for frame in (first, second, third):
        assert frame.desk.next_lease(WEAK) is None
        assert frame.desk.next_lease(GOOD) is not None


def test_a_run_that_begins_again_counts_its_failures_once(make_frame):  # type: ignore[no-untyped-def]
    standing = Standing()
    first = make_frame(standing, "job/1")
    first.trust.failed(WEAK, "it refuses", ["weak"])
    again = make_frame(standing, "job/1", first.record)
    again.trust.failed(WEAK, "it refuses", ["weak"])
    assert not standing.blocked("weak")
    restarted = make_frame(Standing(), "job/1", again.record)
    restarted.trust.failed(WEAK, "it refuses", ["weak"])
    assert [use.blocked for use in restarted.record.devices.values()] == ["failures"]


def test_a_check_whose_answer_will_not_come_goes_to_others() -> None:
    """A run that waits for room on its disk hears nothing meanwhile; its end would wait for that answer for ever."""
    spec = RenderSpec("scene.json", "h", None, None, 0.0, 4, 0)
    desk = LeaseDesk("job", spec, hungry=lambda: None, verify=1.0)
    desk.add([WorkItem(Tile(0, 0, 64, 64), 0, 1)])
    lease = desk.next_lease(GOOD)
    assert lease is not None
    assert desk.answered(LeaseResult(lease.id, (), 1.0), GOOD)
    check = desk.next_lease(WEAK)
    assert check is not None
    assert desk.doubts([GOOD, WEAK])
    desk.suspend()
    assert not desk.doubts([GOOD])
    again = desk.next_lease(WEAK)
    assert again is not None
    assert again.items == check.items
    assert desk.checked(LeaseResult(again.id, (), 1.0), WEAK) == []
    assert not desk.doubts([GOOD, WEAK])


def test_where_one_frame_has_no_device_left_none_has(make_frame):  # type: ignore[no-untyped-def]
    standing = Standing()
    first, second = (make_frame(standing, name, None, (WEAK,)) for name in ("job/1", "job/2"))
    second.trust.demand_device()
    first.trust.failed(WEAK, "it refuses", ["weak"])
    first.trust.failed(WEAK, "it refuses", ["weak"])
    with pytest.raises(RunFailedError, match="the last: it refuses"):
        first.trust.failed(WEAK, "it refuses", ["weak"])
    with pytest.raises(RunFailedError, match="the last: it refuses"):
        second.trust.demand_device()
