"""Device processes: they end with their parent, and their number and state are told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from penumbra_scene.job import DeviceState
from penumbra_service.engine.local import LocalEngine, NoDeviceError, list_devices
from penumbra_service.engine.protocol import DeviceDescription, Lease, RenderSpec, ToJob
from penumbra_service.jobs.planning import WorkItem

FAKE = Path(__file__).with_name("fake_device.py")
PARENT = """
import sys, time
from penumbra_service.engine.local import LocalEngine
engine = LocalEngine(command=(sys.executable, sys.argv[1]))
engine.start()
engine.wait_known()
while not engine._slots[0].ready:
    time.sleep(0.01)
print(engine._slots[0].process.pid, flush=True)
time.sleep(600)
"""


def _alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_device_process_ends_with_its_parent_even_if_that_is_killed():
    with subprocess.Popen(
        [sys.executable, "-c", PARENT, str(FAKE)], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert _alive(child)
        os.kill(parent.pid, signal.SIGKILL)
    end = time.monotonic() + 10
    while _alive(child):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_unknown_devices_are_named_with_those_that_are_there(monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setenv("FAKE_DEVICES", "fake:0,fake:1")
    command = (sys.executable, str(FAKE))
    assert [d.id for d in list_devices(command)] == ["fake:0", "fake:1"]
    with LocalEngine(["fake:7"], command=command) as engine:
        with pytest.raises(NoDeviceError, match="no OpenCL device fake:7; this machine has: fake:0, fake:1"):
            engine.wait_known(60)
        assert engine.devices() == []
    with LocalEngine(["fake:1"], command=command) as engine:
        assert [d.id for d in engine.wait_known(60)] == ["fake:1"]


def test_a_process_that_cannot_list_devices_is_no_crash():
    with pytest.raises(NoDeviceError, match="no such thing"):
        list_devices((sys.executable, "-c", "import sys; sys.exit('no such thing')"))


class _Source:
    """Hands out one lease for ever."""

    gain = 1.0

    def __init__(self, priority: int, scene: Path, name: str = "s") -> None:
        self.scene = name
        self.job = f"j{priority}"
        self.priority = priority
        self.asked = 0
        self.events: list[ToJob] = []
        self._spec = RenderSpec(str(scene), name, None, None, 0.0, 2, 0)

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        from penumbra_kernels.nodes import Tile

        self.asked += 1
        item = WorkItem(Tile(0, 0, 4, 4), 0, 1)
        return Lease(f"{self.priority}/{self.asked}", self.job, self._spec, (item,), 60.0)

    def deliver(self, device: DeviceDescription, event: ToJob) -> None:
        self.events.append(event)


def test_the_more_urgent_job_goes_first_and_two_leases_are_in_flight(make_task, fake_engine):  # type: ignore[no-untyped-def]
    engine = fake_engine()
    task = make_task(name="slow")
    task.folder.mkdir()
    path = task.folder / "scene.json"
    path.write_text(task.scene.model_dump_json())
    calm, urgent = _Source(0, path), _Source(5, path)
    engine.attach(urgent)
    engine.attach(calm)
    most = 0
    end = time.monotonic() + 30
    while len(urgent.events) < 5:
        assert time.monotonic() < end
        most = max(most, len(engine._slots[0].held) if engine._slots else 0)
        time.sleep(0.005)
    assert engine.devices()[0].state is DeviceState.BUSY
    assert engine.devices()[0].job == "j5"
    engine.detach(urgent)
    engine.detach(calm)
    assert most == 2
    assert calm.asked == 0
    time.sleep(0.5)
    told = len(urgent.events)
    time.sleep(0.3)
    assert len(urgent.events) == told


def test_while_one_jobs_program_is_compiled_another_jobs_leases_go_on(make_task, fake_engine):  # type: ignore[no-untyped-def]
    engine = fake_engine()
    sources = []
    for priority, name in ((5, "compiling"), (0, "slow")):
        task = make_task(name=name, folder=name)
        task.folder.mkdir()
        path = task.folder / "scene.json"
        path.write_text(task.scene.model_dump_json())
        sources.append(_Source(priority, path, name))
    urgent, calm = sources
    engine.attach(urgent)
    engine.attach(calm)
    end = time.monotonic() + 30
    while not urgent.events:
        assert time.monotonic() < end
        before, asked = len(calm.events), urgent.asked
        time.sleep(0.002)
    while len(urgent.events) < 4:
        assert time.monotonic() < end
        time.sleep(0.005)
    assert before > 5, "of some 20 leases of 0.05 s, in a second"
    assert asked <= 2, "more would only wait as well"
    engine.detach(urgent)
    engine.detach(calm)
    while engine.devices()[0].state is not DeviceState.IDLE:
        assert time.monotonic() < end
        time.sleep(0.01)
    assert not engine._slots[0].waiting
