"""The service's queue at work: threads that claim jobs from the ledger, hand them to a runner, and write down what it
reports.

Several services may work on one ledger. Each holds what it claimed, and says every BEAT_SECONDS that it lives; what a
service that has been silent for DEAD_SECONDS held is claimed anew. What another service did to a held job (it was
cancelled, paused, moved, or taken over) is seen at the next beat. Silence is measured by the ledger's clock alone.
"""

from __future__ import annotations

import logging
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from penumbra_scene.errors import Problem, make_problem
from penumbra_scene.job import JobRequest, JobState, StopReason

from penumbra_service import results
from penumbra_service.frame_book import ServiceFrameBook
from penumbra_service.log_context import bind
from penumbra_service.running import Control, Halt, Outcome, Runner, Task
from penumbra_service.settings import Settings
from penumbra_service.store.artifacts import Artifacts
from penumbra_service.store.database import gently, is_passing
from penumbra_service.store.frames import FrameStore
from penumbra_service.store.ids import new_id
from penumbra_service.store.jobs import JobRow, JobStore, NoSuchJobError
from penumbra_service.watchers import Watchers

log = logging.getLogger(__name__)

TRACING: Final = (JobState.COMPILING, JobState.RENDERING)
"""States in which devices are asked for."""
ACTIVE: Final = (JobState.COMPILING, JobState.RENDERING, JobState.FINISHING)
"""States in which a runner has the job."""
WAITING: Final = (JobState.QUEUED,)
OPEN: Final = (*WAITING, *ACTIVE, JobState.PAUSED)
"""States that are no end."""
RETRY_SECONDS: Final = 5.0
"""Wait of the queue after the ledger could not be read or written."""
BEAT_SECONDS: Final = 2.0
DEAD_SECONDS: Final = 10.0
"""A service that was silent for so long is dead, to one that has been in touch with the ledger itself for as long: where the
ledger was away, all were silent."""
LONG_DEAD_SECONDS: Final = 30.0
"""And to one that has just started."""
LOOK_SECONDS: Final = 2.0
"""How often a queue that shares its ledger looks for jobs that other services took in."""


@dataclass
class Held:
    """A job that a runner has."""

    row: JobRow
    control: Control = field(default_factory=Control)
    reporting: threading.Lock = field(default_factory=threading.Lock)
    """Held while the job's progress is read, changed and written: frames report in threads of their own."""


class JobQueue:
    """`request`: what a job asks for; `spent`: told of device-seconds as they are used, says whether a job may use no
    more."""

    def __init__(
        self,
        settings: Settings,
        jobs: JobStore,
        frames: FrameStore,
        artifacts: Artifacts,
        watchers: Watchers,
        runner: Runner,
        request: Callable[[str], JobRequest],
        spent: Callable[[JobRow, float], bool],
    ) -> None:
        self._settings = settings
        self._jobs = jobs
        self._frames = frames
        self._artifacts = artifacts
        self._watchers = watchers
        self._runner = runner
        self._request = request
        self._spent = spent
        self._name = new_id()
        self._wake = threading.Condition()
        self._stopping = False
        self._in_touch: float | None = None
        """Since when beats have succeeded, by the monotonic clock."""
        self._held: dict[str, Held] = {}
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Puts what a dead service left running back into the queue, and begins to work."""
        self._release(LONG_DEAD_SECONDS)
        for number in range(self._settings.slots):
            self._begin(self._work, f"penumbra-queue-{number}")
        self._begin(self._watch, "penumbra-heartbeat")

    def stop(self) -> None:
        """Has the running jobs write their snapshots, then ends."""
        with self._wake:
            self._stopping = True
            for held in self._held.values():
                held.control.halt(Halt.SHUTDOWN)
            self._wake.notify_all()
        deadline = datetime.now(UTC) + timedelta(seconds=self._settings.shutdown_seconds)
        for thread in self._threads:
            thread.join(max((deadline - datetime.now(UTC)).total_seconds(), 0.0))
        if any(thread.is_alive() for thread in self._threads):
            log.warning("a running job did not stop in time; it will go on from an earlier snapshot")

    def changed(self, row: JobRow) -> None:
        """A row of the ledger is another one now: wakes whom it concerns."""
        with self._wake:
            held = self._held.get(row.id)
            if held is not None:
                held.row = row
                held.control.prioritize(row.priority)
            self._overtake()
            self._wake.notify_all()
        self._watchers.ring(row.id)

    def halt(self, job_id: str, reason: Halt) -> None:
        """Stops a job if it runs here."""
        with self._wake:
            held = self._held.get(job_id)
        if held is not None:
            held.control.halt(reason)

    def has(self, job_id: str) -> bool:
        """Whether the runner has this job."""
        with self._wake:
            return job_id in self._held

    @property
    def running(self) -> list[JobRow]:
        """The jobs that the runner has."""
        with self._wake:
            return [held.row for held in self._held.values()]

    def work_folder(self, job_id: str) -> Path:
        """Where a job keeps snapshots and unfinished files."""
        return self._settings.work_folder / job_id

    def clean(self, job_id: str) -> None:
        """A job that has ended needs no snapshots."""
        try:
            ended = JobState(self._jobs.get(job_id).state).ended
        except NoSuchJobError:
            ended = True
        if ended:
            shutil.rmtree(self.work_folder(job_id), ignore_errors=True)

    def _begin(self, target: Callable[[], None], name: str) -> None:
        thread = threading.Thread(target=target, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _overtake(self) -> None:
        """Stops the least urgent of the running jobs where all places are taken and a more urgent one waits."""
        if len(self._held) < self._settings.slots:
            return
        waiting = self._jobs.waiting(WAITING, limit=1)
        least = min(self._held.values(), key=lambda held: (held.row.priority, held.row.started))
        if waiting and waiting[0].priority > least.row.priority:
            least.control.halt(Halt.YIELD)

    def _work(self) -> None:
        """Until the service stops. A disk that is full or a ledger that is locked only makes the queue wait."""
        while not self._stopping:
            try:
                self._work_one()
            except Exception:
                log.exception("the queue cannot go on; it tries again in %g s", RETRY_SECONDS)
                with self._wake:
                    self._wake.wait_for(lambda: self._stopping, RETRY_SECONDS)

    def _work_one(self) -> None:
        held = self._take()
        if held is None:
            return
        row = held.row
        with bind(job=row.id):
            try:
                self._run(held)
            except Exception as error:
                if is_passing(error):
                    log.warning(
                        "job %s: ledger or results cannot be written; it goes on later: %s", row.id, error
                    )
                    self._abandon(held)
                else:
                    log.exception("job %s: the service failed", row.id)
                    self._try_to_end(held)
            finally:
                with self._wake:
                    self._held.pop(row.id, None)
                    self._wake.notify_all()

    def _try_to_end(self, held: Held) -> None:
        """The job fails; where not even that can be written, it goes back into the queue once it can be."""
        try:
            self._end(held, Outcome(problem=_internal_problem()))
            self.clean(held.row.id)
        except Exception:
            with self._wake:
                self._held.pop(held.row.id, None)
            self._abandon(held)
            raise

    def _abandon(self, held: Held) -> None:
        """Gives the job up as soon as the ledger can be written."""

        def give_up() -> None:
            while not self._stopping:
                with self._wake:  # what just failed would fail again at once
                    if self._wake.wait_for(lambda: self._stopping, RETRY_SECONDS):
                        return
                try:
                    if self._jobs.move(held.row.id, ACTIVE, JobState.QUEUED, holder=self._name) is not None:
                        self.changed(self._jobs.get(held.row.id))
                    return
                except Exception as error:
                    log.warning("job %s: it cannot be put back into the queue yet: %s", held.row.id, error)

        self._begin(give_up, "penumbra-queue-retry")

    def _take(self) -> Held | None:
        """Waits for a job and claims it; None once the service stops."""
        patience = LOOK_SECONDS if self._settings.shared else None
        with self._wake:
            while not self._stopping:
                row = self._jobs.claim(WAITING, JobState.COMPILING, self._name)
                if row is not None:
                    held = self._held[row.id] = Held(row)
                    return held
                self._wake.wait(patience)
        return None

    def _release(self, silent_seconds: float) -> None:
        """Puts jobs that say that they run, while nobody runs them, back into the queue: where others may run them, those
        of services that were silent for so long."""
        for row in self._jobs.release(
            ACTIVE, JobState.QUEUED, silent_seconds if self._settings.shared else None
        ):
            log.warning("job %s: the service that held it is gone; it is queued again", row.id)
            self.changed(row)

    def _watch(self) -> None:
        """Tells that this service lives, and sees what others did to its jobs."""
        shared = self._settings.shared
        while True:
            with self._wake:
                # What still writes its snapshot must not be taken for dead by others.
                if self._wake.wait_for(lambda: self._stopping and not (shared and self._held), BEAT_SECONDS):
                    return
                stopping = self._stopping
                held = list(self._held.values())
            try:
                self._jobs.beat(self._name, ACTIVE)
                for entry in held:
                    self._look(entry)
                now = time.monotonic()
                self._in_touch = now if self._in_touch is None else self._in_touch
                if shared and not stopping and now - self._in_touch >= DEAD_SECONDS:
                    self._release(DEAD_SECONDS)
            except Exception:
                self._in_touch = None
                log.warning("the ledger cannot be reached", exc_info=True)

    def _look(self, held: Held) -> None:
        """Compares a job that runs here with its row."""
        try:
            row = self._jobs.get(held.row.id)
        except NoSuchJobError:
            held.control.halt(Halt.CANCEL)
            return
        if row.holder != self._name:
            held.control.halt(Halt.SHUTDOWN)
        elif row.state == JobState.PAUSED:
            held.control.halt(Halt.PAUSE)
        elif row.state == JobState.CANCELLED:
            held.control.halt(Halt.CANCEL)
        elif row.priority != held.row.priority:
            self.changed(row)

    def _run(self, held: Held) -> None:
        row = held.row
        if self._spent(row, 0.0):
            self._pause_for_quota(held)
            return
        self._watchers.ring(row.id)
        folder = self.work_folder(row.id)
        folder.mkdir(parents=True, exist_ok=True)
        log.info("job %s: begins", row.id)
        task = Task(
            row.id,
            self._request(row.id),
            folder,
            row.priority,
            row.created,
            row.started or row.created,
            held.control,
            report=lambda state, news: gently(lambda: self._report(held, state, news)),
            show=lambda: gently(lambda: self._show(held)),
            frames=ServiceFrameBook(
                row.id, folder, self._frames, self._artifacts, show_job=lambda: self._show(held)
            ),
        )
        outcome = self._runner.run(task)
        if outcome.final:
            self._publish(row.id, (*results.ALL, *results.OF_SEQUENCE))
            self._end(held, outcome)
        elif self._jobs.move(row.id, ACTIVE, JobState.QUEUED, holder=self._name) is not None:
            log.info("job %s: waits again (%s)", row.id, held.control.reason)
            self._watchers.ring(row.id)
        self.clean(row.id)

    def _report(self, held: Held, state: JobState, news: Mapping[str, Any]) -> None:
        # A job that was paused, cancelled or taken over in the meantime is not touched.
        job_id = held.row.id
        with held.reporting:
            row = self._jobs.get(job_id)
            progress = {**row.progress, **news}
            moved = self._jobs.move(job_id, ACTIVE, state, holder=self._name, progress=progress)
            if moved is not None:
                more = news.get("device_seconds", 0.0) - row.progress.get("device_seconds", 0.0)
                if more > 0 and self._spent(row, more):
                    self._pause_for_quota(held)
        if moved is not None:
            self._watchers.ring(job_id)

    def _pause_for_quota(self, held: Held) -> None:
        """Its key has no device-seconds left: it stops with a snapshot, unless its picture is there already."""
        job_id, why = held.row.id, StopReason.QUOTA
        if self._jobs.move(job_id, TRACING, JobState.PAUSED, holder=self._name, reason=why) is not None:
            log.info("job %s: paused, the quota of its key is used up", job_id)
            held.control.halt(Halt.PAUSE)
            self._watchers.ring(job_id)

    def _show(self, held: Held) -> None:
        job_id = held.row.id
        self._publish(job_id, (results.THUMBNAIL, results.HEATMAP, results.CONTACT_SHEET))
        with held.reporting:
            row = self._jobs.get(job_id)
            revision = row.progress.get("thumbnail_revision", 0) + 1
            self._jobs.set(job_id, progress={**row.progress, "thumbnail_revision": revision})
        self._watchers.ring(job_id)

    def _publish(self, job_id: str, names: Iterable[str]) -> None:
        for name in names:
            path = self.work_folder(job_id) / name
            if path.is_file():
                self._artifacts.put(job_id, name, path)

    def _end(self, held: Held, outcome: Outcome) -> None:
        job_id = held.row.id
        failed = outcome.problem is not None
        reason = StopReason.FAILED if failed else outcome.stop_reason
        state = JobState.FAILED if failed else JobState.DONE
        with held.reporting:
            progress = dict(self._jobs.get(job_id).progress)
            if outcome.problem is not None:
                progress["problem"] = outcome.problem.model_dump(mode="json")
            else:
                progress |= {
                    "progress": 1.0,
                    "predicted_seconds": None,
                    "predicted_seconds_interval": None,
                    "thumbnail_revision": progress.get("thumbnail_revision", 0) + 1,
                }
            # a job that was paused while its last files were written is done nevertheless
            self._jobs.move(
                job_id,
                (*ACTIVE, JobState.PAUSED),
                state,
                holder=self._name,
                reason=reason,
                progress=progress,
                finished=datetime.now(UTC),
            )
        log.info("job %s: %s (%s)", job_id, state, reason)
        self._watchers.ring(job_id)


def _internal_problem() -> Problem:
    return make_problem(
        "internal",
        "The service failed",
        500,
        "an error of the service itself ended the job; its log says more",
    )
