"""One job from its plan to its picture: plan -> engine -> canvas -> stop or go on.

Threads: `run` blocks in the thread that calls it, which alone touches the course, its canvas, and the replies. The
engine's thread calls `next_lease` and `deliver`, which meet it at the desk and in a queue. `halt` may be
called from anywhere. Callbacks come on the thread of `run`.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import time
from collections.abc import Callable
from typing import Final

from penumbra_scene.check import scene_hash
from penumbra_scene.job import JobState, Progress, StopReason

from penumbra_service.engine.clock import TraceClock
from penumbra_service.engine.course import Course
from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.protocol import DeviceDescription, Engine, Lease, RenderSpec, ToJob
from penumbra_service.engine.replies import Replies
from penumbra_service.engine.reporter import Reporter
from penumbra_service.engine.snapshot import kernel_hash
from penumbra_service.engine.task import Failure, Halt, RenderTask, RunFailedError, RunResult
from penumbra_service.film.preview import PreviewImage
from penumbra_service.film.replicates import Layout, choose_layout
from penumbra_service.film.tilefile import FolderTileStore
from penumbra_service.jobs.life import StopReached, WentWrong
from penumbra_service.store.room import is_full

__all__ = ["Failure", "Halt", "JobRunner", "RenderTask", "RunResult"]

log = logging.getLogger(__name__)

TICK_SECONDS: Final = 0.25
SPACE_SECONDS: Final = 5.0
"""Wait before a disk that was full is tried again."""


class JobRunner:
    """Runs one RenderTask on an engine, once. Implements protocol.LeaseSource.

    Raises film.replicates.UnknownErrorTargetError where an error is asked for that cannot be known.
    """

    def __init__(
        self,
        engine: Engine,
        task: RenderTask,
        *,
        on_progress: Callable[[JobState, Progress], None] = lambda state, progress: None,
        on_preview: Callable[[PreviewImage], None] = lambda image: None,
    ) -> None:
        self._engine = engine
        self._task = task
        self._priority = task.priority
        layout = task.layout or choose_layout(task.scene.sampler, task.scene.stop)
        spec = spec_of(task, layout)
        self._scene = spec.key
        self._inbox: queue.SimpleQueue[tuple[DeviceDescription, ToJob] | None] = queue.SimpleQueue()
        self._halt: Halt | None = None
        clock = TraceClock(0.0)
        self._desk = LeaseDesk(
            task.job,
            spec,
            hungry=lambda: self._inbox.put(None),
            strict=task.strict,
            verify=task.verify,
            busy=clock.busy,
            name=task.name,
            barred=task.standing.blocked,
        )
        key = f"{self._scene}-{kernel_hash()}"
        self._course = Course(engine, task, layout, key, self._desk, clock, looked=self._tell_now)
        self._replies = Replies(self._course, self._desk, engine, task, ready=self._tell_now)
        self._reporter = Reporter(on_progress, on_preview)

    @property
    def job(self) -> str:
        return self._task.job

    @property
    def priority(self) -> int:
        return self._priority

    @property
    def scene(self) -> str:
        return self._scene

    @property
    def gain(self) -> float:
        """By the newest error that is known (jobs.dispatch)."""
        return self._course.gain

    def halt(self, reason: Halt) -> None:
        """Ask the run to end; it does within a moment, and devices are through with it within two leases."""
        if self._halt is not Halt.CANCEL:
            self._halt = reason
        self._inbox.put(None)

    def prioritize(self, priority: int) -> None:
        """Higher ones go first, from the next lease on."""
        self._priority = priority

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """Work for a device (engine's thread)."""
        return self._desk.next_lease(device)

    def deliver(self, device: DeviceDescription, event: ToJob) -> None:
        """News for the run (engine's thread)."""
        self._inbox.put((device, event))

    def run(self) -> RunResult:
        """Render, from the snapshot in the task's folder if there is one. Blocks until the picture is there,
        the run has failed, or `halt` was asked for."""
        try:
            while True:
                try:
                    return self._attempt()
                except OSError as error:
                    if not (self._task.wait_for_room and is_full(error)):
                        raise
                    log.warning(
                        "job %s: %s; it goes on from its last snapshot when there is room", self.job, error
                    )
                self._suspend()
                if self._halt is not None:
                    state = JobState.CANCELLED if self._halt is Halt.CANCEL else JobState.PAUSED
                    reason = StopReason.CANCELLED if state.ended else None
                    return RunResult(state, self._course.record, reason)
        except RunFailedError as failed:
            return self._fail(failed.failure)
        except OSError as error:
            log.exception("job %s: its folder cannot be used", self.job)
            return self._fail(Failure("storage", f"the job's files cannot be read or written: {error}"))
        finally:
            self._desk.close()
            self._engine.detach(self)

    def _attempt(self) -> RunResult:
        scene = self._task.scene.model_dump_json().encode()
        FolderTileStore(self._task.folder).write("scene.json", scene)
        self._course.resume()
        self._replies.begin(self._course.record)
        self._engine.attach(self)
        return self._loop()

    def _suspend(self) -> None:
        """Let go of all that is not on disk, and wait a while."""
        self._engine.detach(self)
        self._course.suspend()
        end = time.monotonic() + SPACE_SECONDS
        while self._halt is None and time.monotonic() < end:
            with contextlib.suppress(queue.Empty):
                self._inbox.get(timeout=TICK_SECONDS)

    def _loop(self) -> RunResult:
        course = self._course
        while True:
            course.advance()
            if course.reason is not None and not self._replies.unsure():
                return self._finish(course.reason)
            self._hear()
            if self._halt is not None:
                return self._halted(self._halt)
            self._replies.demand_device()
            if course.reason is None and course.overdue:
                course.reason = "seconds"
                continue
            self._reporter.tell(self._replies.life.state, course)
            course.keep()

    def _hear(self) -> None:
        """Wait for news and take in all that is there."""
        try:
            entry = self._inbox.get(timeout=TICK_SECONDS)
            while True:
                if entry is not None:
                    self._replies.take(*entry)
                entry = self._inbox.get_nowait()
        except queue.Empty:
            return

    def _tell_now(self) -> None:
        self._reporter.tell(self._replies.life.state, self._course, force=True)

    def _finish(self, reason: str) -> RunResult:
        """The picture is there."""
        self._desk.close()
        end = self._course.settle()
        self._replies.step(StopReached())
        self._reporter.tell(self._replies.life.state, self._course, force=True, share=1.0)
        return RunResult(
            self._replies.life.state,
            self._course.record,
            StopReason(reason),
            film=self._course.canvas.film,
            end=end,
            layers=self._task.scene.film.layers,
            levels=self._course.stage.levels,
        )

    def _halted(self, halt: Halt) -> RunResult:
        self._desk.close()
        self._course.stop()
        if halt is Halt.CANCEL:
            return RunResult(JobState.CANCELLED, self._course.record, StopReason.CANCELLED)
        self._course.save_all()
        return RunResult(JobState.PAUSED, self._course.record)

    def _fail(self, failure: Failure) -> RunResult:
        self._desk.close()
        if not self._replies.life.state.ended:
            self._replies.step(WentWrong(failure.message))
        return RunResult(JobState.FAILED, self._course.record, StopReason.FAILED, failure)


def spec_of(task: RenderTask, layout: Layout) -> RenderSpec:
    """What devices must load for a task."""
    return RenderSpec(
        scene_path=str((task.folder / "scene.json").resolve()),
        scene_hash=scene_hash(task.scene),
        assets_folder=None if task.assets_folder is None else str(task.assets_folder.resolve()),
        scene_folder=None if task.scene_folder is None else str(task.scene_folder.resolve()),
        time=task.time,
        replicates=layout.replicates,
        strata=layout.strata,
        program=task.program,
        decode=task.decode,
    )
