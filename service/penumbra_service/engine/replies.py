"""What a run makes of its devices' answers: sums for the picture, work that goes to others, or the run's end.

One thread, the run's.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from penumbra_scene.job import JobState

from penumbra_service.engine.course import Course
from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.protocol import (
    DeviceDescription,
    Engine,
    LeaseFailure,
    LeaseLost,
    LeaseResult,
    NoDevice,
    SceneLoaded,
    ToJob,
)
from penumbra_service.engine.task import RenderTask, RunFailedError
from penumbra_service.engine.trust import Trust
from penumbra_service.jobs.life import DeviceCrashed, Event, Life, SceneReady, step
from penumbra_service.jobs.record import Effect, RunRecord

log = logging.getLogger(__name__)


class Replies:
    """Of the run of a task; `life` is where it stands. `ready` is called when a device has loaded the scene."""

    def __init__(
        self, course: Course, desk: LeaseDesk, engine: Engine, task: RenderTask, ready: Callable[[], None]
    ) -> None:
        self._course = course
        self._desk = desk
        self._engine = engine
        self._task = task
        self._ready = ready
        self.life = Life(JobState.COMPILING)

    def begin(self, record: RunRecord) -> None:
        """A run, or its next attempt, goes on from this record."""
        self.life = Life(JobState.COMPILING, record.crashes)
        task = self._task
        self._trust = Trust(record, self._desk, self._engine.usable, task.standing, task.name)
        self._checked_before = record.checked_leases

    def step(self, event: Event) -> None:
        """The run's life goes on."""
        self.life, _ = step(self.life, event)

    def take(self, device: DeviceDescription, event: ToJob) -> None:
        """Raises RunFailedError where nothing else is left to do, OSError where the disk refuses."""
        match event:
            case LeaseResult():
                self._take_result(device, event)
            case SceneLoaded():
                self._take_scene(device, event)
            case LeaseLost(lease, _, blamed, reason):
                tried = self._give_back(lease, device.id if blamed else None)
                if blamed:
                    self._crashed(device, reason, tried)
            case LeaseFailure():
                self._take_failure(device, event)
            case NoDevice(reason):
                raise RunFailedError("device", reason)

    def demand_device(self) -> None:
        """Raises RunFailedError where the job has no device left."""
        self._trust.demand_device()

    def unsure(self) -> bool:
        """Whether to wait for checks that devices are still at, now that the picture is there. Raises RunFailedError
        where devices contradict each other and nobody can tell which is right."""
        self._desk.wind_up()
        if self._desk.doubts(self._engine.usable()):
            return True
        self._trust.settle()
        return False

    def _take_result(self, device: DeviceDescription, result: LeaseResult) -> None:
        if not self._trust.believes(device):
            self._give_back(result.lease)
            return
        wrong = self._desk.checked(result, device)
        if wrong is not None:
            self._take_check(device, result, wrong)
        elif self._desk.answered(result, device):
            self._course.clock.start()
            self._trust.delivered(device, result)
            self._note_program(device, result)
            self._course.take(result.nodes)

    def _note_program(self, device: DeviceDescription, result: LeaseResult) -> None:
        """Which samples are of which program: their bits are the same, and whoever doubts it can tell them apart."""
        use = self._course.record.use_of_program(device.id, result.program, result.program_hash)
        firsts = [node.first_sample for node in result.nodes] + ([use.first_sample] if use.leases else [])
        use.first_sample = min(firsts)
        use.end = max(use.end, *(node.first_sample + node.sample_count for node in result.nodes))
        use.leases += 1
        use.samples += sum(n.sums.total("taken") + n.sums.total("rejected") for n in result.nodes)

    def _take_check(self, device: DeviceDescription, result: LeaseResult, wrong: list[str]) -> None:
        """Another device has done a lease that is there already."""
        self._trust.spent(device, result)
        self._course.record.checked_leases = self._checked_before + self._desk.checks
        self._course.discard([self._trust.disbelieve(other) for other in wrong])
        self._engine.wake()

    def _take_scene(self, device: DeviceDescription, loaded: SceneLoaded) -> None:
        record = self._course.record
        self._course.clock.start()
        self.step(SceneReady())
        record.build_seconds += loaded.build_seconds
        record.compile_seconds += loaded.compile_seconds
        record.build_warm = loaded.build_warm and record.build_warm is not False
        record.compile_warm = loaded.compile_warm and record.compile_warm is not False
        record.effects = [Effect(*effect) for effect in loaded.effects]
        before, record.program_hash = record.program_hash, loaded.program_hash
        use = record.use_of_program(device.id, loaded.program, loaded.program_hash)
        use.background_seconds += loaded.background_seconds
        if before is not None and loaded.background_seconds:
            log.info("job %s: on device %s the scene's own program takes over", self._task.job, device.id)
        self._trust.use_of(device)
        self._ready()

    def _take_failure(self, device: DeviceDescription, failure: LeaseFailure) -> None:
        if failure.kind in ("scene", "storage"):
            raise RunFailedError(failure.kind, failure.message)
        build = failure.kind == "build"
        tried = self._give_back(failure.lease, None if build else device.id)
        if build:
            self._trust.refused_to_build(device, failure.message)
        else:
            self._crashed(device, f"device {device.id}: {failure.message}", tried)

    def _give_back(self, lease: str, failed_on: str | None = None) -> frozenset[str]:
        """The work goes to others; the devices that it has failed on."""
        tried = self._desk.give_back(lease, failed_on)
        self._course.record.redone_leases += 1
        self._engine.wake()
        return tried

    def _crashed(self, device: DeviceDescription, reason: str, tried: frozenset[str]) -> None:
        self.step(DeviceCrashed(reason))
        self._course.record.crashes = self.life.crashes
        try:
            self._trust.failed(device, reason, tried)
        finally:
            self._course.save()
