"""The render service without HTTP: takes jobs in, runs one at a time, survives restarts, tells whoever
watches.

A job waits in the ledger. One thread takes the first of the queue (higher priority, then older), hands it
to a runner, and writes down what the runner reports. Cancelling, pausing and overtaking are all done by
asking the runner to stop: it leaves a snapshot, from which the job can go on later.
"""

from __future__ import annotations

import logging
import shutil
import threading
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from penumbra_scene.errors import Problem, make_problem
from penumbra_scene.job import JobRequest, JobState, StopReason
from penumbra_scene.parse import job_from_json, parse_json

from penumbra_service import results
from penumbra_service.frame_book import ServiceFrameBook
from penumbra_service.images.assets import FolderAssets
from penumbra_service.images.limits import DecodeLimits
from penumbra_service.running import Control, Halt, Outcome, Runner, Task
from penumbra_service.settings import Settings
from penumbra_service.status import initial_progress
from penumbra_service.store.artifacts import Artifacts
from penumbra_service.store.assets import AssetStore
from penumbra_service.store.database import Database
from penumbra_service.store.frames import FrameStore
from penumbra_service.store.jobs import JobRow, JobStore, NewJob, SqlJobStore
from penumbra_service.store.keys import KeyStore
from penumbra_service.watchers import Watchers

log = logging.getLogger(__name__)

ACTIVE: Final = (JobState.COMPILING, JobState.RENDERING, JobState.FINISHING)
"""States in which a runner has the job."""
WAITING: Final = (JobState.QUEUED,)
OPEN: Final = (*WAITING, *ACTIVE, JobState.PAUSED)
"""States that are no end."""
RETRY_SECONDS: Final = 5.0
"""Wait of the queue after the ledger could not be read or written."""


class ConflictError(Exception):
    """The job is in a state that does not allow this."""

    def __init__(self, job: JobRow, action: str, allowed: str) -> None:
        super().__init__(f"job {job.id} is {job.state}; to {action} it, it must be {allowed}")


class RenderService:
    """Everything that the HTTP pages ask for."""

    def __init__(self, settings: Settings, runner: Runner) -> None:
        self.settings = settings
        self.runner = runner
        settings.data.mkdir(parents=True, exist_ok=True)
        self.database = Database(settings.database)
        self.database.migrate()
        self.keys = KeyStore(self.database)
        self.jobs: JobStore = SqlJobStore(self.database)
        self.frames = FrameStore(self.database)
        self.artifacts = Artifacts(settings.artifacts)
        self.asset_store = AssetStore(self.database, settings.assets_folder, settings.max_asset_bytes)
        self.assets = FolderAssets(settings.assets_folder, limits=decode_limits(settings))
        self.watchers = Watchers()
        self.started = datetime.now(UTC)
        self._wake = threading.Condition()
        self._reporting = threading.Lock()
        """Held while a job's progress is read, changed and written: frames report in threads of their own."""
        self._stopping = False
        self._running: tuple[JobRow, Control] | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Puts what an earlier process left running back into the queue, and begins to work."""
        self._requeue()
        self._sweep()
        self.runner.start()
        self._thread = threading.Thread(target=self._work, name="penumbra-queue", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Has the running job write its snapshot, then ends."""
        with self._wake:
            self._stopping = True
            if self._running is not None:
                self._running[1].halt(Halt.SHUTDOWN)
            self._wake.notify_all()
        if self._thread is not None:
            self._thread.join(self.settings.shutdown_seconds)
            if self._thread.is_alive():
                log.warning("the running job did not stop in time; it will go on from an earlier snapshot")
        self.runner.stop()
        self.database.close()

    @property
    def needs_key(self) -> bool:
        """Whether callers must show a key: others can reach the service, or a key was ever made."""
        return self.settings.public or self.keys.any_made()

    def submit(self, job: NewJob) -> tuple[JobRow, bool]:
        """The job and whether it is new. Raises store.jobs.IdempotencyConflictError."""
        row, created = self.jobs.create(job)
        if created:
            self._changed(row)
        return row, created

    def cancel(self, job_id: str) -> JobRow:
        """Ends a job; one that is cancelled already stays so. Raises NoSuchJobError, ConflictError."""
        now = datetime.now(UTC)
        row = self.jobs.move(job_id, OPEN, JobState.CANCELLED, finished=now, reason=StopReason.CANCELLED)
        if row is None:
            row = self.jobs.get(job_id)
            if row.state != JobState.CANCELLED:
                raise ConflictError(row, "cancel", "queued, running or paused")
        self._halt(job_id, Halt.CANCEL)
        if not self._has(job_id):
            self._clean(job_id)
        self._changed(row)
        return row

    def pause(self, job_id: str) -> JobRow:
        """Takes a job out of the queue, or stops it with a snapshot. Raises NoSuchJobError, ConflictError."""
        row = self.jobs.move(
            job_id, (JobState.QUEUED, JobState.COMPILING, JobState.RENDERING), JobState.PAUSED
        )
        if row is None:
            row = self.jobs.get(job_id)
            if row.state != JobState.PAUSED:
                raise ConflictError(row, "pause", "queued or running")
        self._halt(job_id, Halt.PAUSE)
        self._changed(row)
        return row

    def resume(self, job_id: str) -> JobRow:
        """Puts a paused job back into the queue. Raises NoSuchJobError, ConflictError."""
        row = self.jobs.move(job_id, (JobState.PAUSED,), JobState.QUEUED)
        if row is None:
            row = self.jobs.get(job_id)
            if JobState(row.state).ended:
                raise ConflictError(row, "resume", "paused")
        self._changed(row)
        return row

    def prioritize(self, job_id: str, priority: int) -> JobRow:
        """Moves a job in the queue. Raises NoSuchJobError, ConflictError."""
        row = self.jobs.get(job_id)
        if JobState(row.state).ended:
            raise ConflictError(row, "re-prioritise", "queued, running or paused")
        row = self.jobs.set(job_id, priority=priority)
        self._changed(row)
        return row

    def request(self, job_id: str) -> JobRequest:
        """What was asked for. Raises NoSuchJobError."""
        text = self.jobs.request(job_id).encode()
        # Its length was checked when it came; as it is kept, numbers may be longer (1e9 is 1000000000.0).
        return job_from_json(parse_json(text, len(text)))

    def _changed(self, row: JobRow) -> None:
        with self._wake:
            if self._running is not None and row.id == self._running[0].id:
                self._running = (row, self._running[1])
            self._overtake()
            self._wake.notify_all()
        self.watchers.ring(row.id)

    def _overtake(self) -> None:
        """Stops the running job if a waiting one has a higher priority."""
        if self._running is None:
            return
        waiting = self.jobs.waiting(WAITING)
        if waiting and waiting[0].priority > self._running[0].priority:
            self._running[1].halt(Halt.YIELD)

    def _halt(self, job_id: str, reason: Halt) -> None:
        with self._wake:
            if self._running is not None and self._running[0].id == job_id:
                self._running[1].halt(reason)

    def _has(self, job_id: str) -> bool:
        """Whether the runner has this job."""
        with self._wake:
            return self._running is not None and self._running[0].id == job_id

    def _work(self) -> None:
        """Until the service stops. A disk that is full or a ledger that is locked only makes the queue wait."""
        lost = False
        while not self._stopping:
            try:
                if lost:
                    self._requeue()
                    lost = False
                self._work_one()
            except Exception:
                log.exception("the queue cannot go on; it tries again in %g s", RETRY_SECONDS)
                lost = True
                with self._wake:
                    self._wake.wait_for(lambda: self._stopping, RETRY_SECONDS)

    def _work_one(self) -> None:
        taken = self._take()
        if taken is None:
            return
        row, control = taken
        try:
            self._run(row, control)
        except Exception:
            log.exception("job %s: the service failed", row.id)
            self._end(row.id, Outcome(problem=_internal_problem()))
            self._clean(row.id)
        finally:
            with self._wake:
                self._running = None

    def _requeue(self) -> None:
        """Puts jobs that say that they run, while none does, back into the queue."""
        for row in self.jobs.waiting(ACTIVE):
            if self.jobs.move(row.id, ACTIVE, JobState.QUEUED) is not None:
                self.watchers.ring(row.id)

    def _sweep(self) -> None:
        """Removes what a killed process left: folders of jobs that have ended, uploads that never did."""
        kept = {row.id for row in self.jobs.waiting(OPEN)}
        if self.settings.work_folder.is_dir():
            for folder in self.settings.work_folder.iterdir():
                if folder.name not in kept:
                    shutil.rmtree(folder, ignore_errors=True)
        self.asset_store.sweep()

    def _take(self) -> tuple[JobRow, Control] | None:
        """Waits for a job and marks it; None once the service stops."""
        with self._wake:
            while not self._stopping:
                for row in self.jobs.waiting(WAITING):
                    started = row.started or datetime.now(UTC)
                    taken = self.jobs.move(row.id, WAITING, JobState.COMPILING, started=started)
                    if taken is not None:
                        self._running = (taken, Control())
                        return self._running
                self._wake.wait()
        return None

    def _run(self, row: JobRow, control: Control) -> None:
        self.watchers.ring(row.id)
        folder = self.work_folder(row.id)
        folder.mkdir(parents=True, exist_ok=True)
        task = Task(
            row.id,
            self.request(row.id),
            folder,
            row.priority,
            row.created,
            row.started or row.created,
            control,
            report=lambda state, news: self._report(row.id, state, news),
            show=lambda: self._show(row.id),
            frames=ServiceFrameBook(
                row.id, folder, self.frames, self.artifacts, show_job=lambda: self._show(row.id)
            ),
        )
        outcome = self.runner.run(task)
        if outcome.final:
            self._publish(row.id, (*results.ALL, *results.OF_SEQUENCE))
            self._end(row.id, outcome)
        elif self.jobs.move(row.id, ACTIVE, JobState.QUEUED) is not None:
            self.watchers.ring(row.id)
        self._clean(row.id)

    def work_folder(self, job_id: str) -> Path:
        """Where a job keeps snapshots and unfinished files."""
        return self.settings.work_folder / job_id

    def _clean(self, job_id: str) -> None:
        """A job that has ended needs no snapshots."""
        if JobState(self.jobs.get(job_id).state).ended:
            shutil.rmtree(self.work_folder(job_id), ignore_errors=True)

    def _report(self, job_id: str, state: JobState, news: Mapping[str, Any]) -> None:
        # A job that was paused or cancelled in the meantime is not touched.
        with self._reporting:
            row = self.jobs.get(job_id)
            moved = self.jobs.move(job_id, ACTIVE, state, progress={**row.progress, **news})
        if moved is not None:
            self.watchers.ring(job_id)

    def _show(self, job_id: str) -> None:
        self._publish(job_id, (results.THUMBNAIL, results.HEATMAP, results.CONTACT_SHEET))
        with self._reporting:
            row = self.jobs.get(job_id)
            revision = row.progress.get("thumbnail_revision", 0) + 1
            self.jobs.set(job_id, progress={**row.progress, "thumbnail_revision": revision})
        self.watchers.ring(job_id)

    def _publish(self, job_id: str, names: Iterable[str]) -> None:
        for name in names:
            path = self.work_folder(job_id) / name
            if path.is_file():
                self.artifacts.put(job_id, name, path)

    def _end(self, job_id: str, outcome: Outcome) -> None:
        row = self.jobs.get(job_id)
        failed = outcome.problem is not None
        reason = StopReason.FAILED if failed else outcome.stop_reason
        progress = dict(row.progress)
        if outcome.problem is not None:
            progress["problem"] = outcome.problem.model_dump(mode="json")
        else:
            progress |= {
                "progress": 1.0,
                "predicted_seconds": None,
                "thumbnail_revision": progress.get("thumbnail_revision", 0) + 1,
            }
        state = JobState.FAILED if failed else JobState.DONE
        now = datetime.now(UTC)
        # a job that was paused while its last files were written is done nevertheless
        self.jobs.move(
            job_id, (*ACTIVE, JobState.PAUSED), state, reason=reason, progress=progress, finished=now
        )
        self.watchers.ring(job_id)


def decode_limits(settings: Settings) -> DecodeLimits:
    """Limits on assets from the settings."""
    return DecodeLimits(
        file_bytes=settings.max_asset_bytes,
        memory_bytes=settings.decode_memory_bytes,
        seconds=settings.decode_seconds,
    )


def new_job(request: JobRequest, text: str, digest: str, owner: str | None, key: str | None) -> NewJob:
    """A row for the ledger from a checked request and the JSON text that says the same."""
    return NewJob(
        request=text,
        body_digest=digest,
        name=request.name or request.scene.name,
        priority=request.priority,
        owner=owner,
        idempotency_key=key,
        state=JobState.QUEUED,
        progress=initial_progress(request),
    )


def _internal_problem() -> Problem:
    return make_problem(
        "internal",
        "The service failed",
        500,
        "an error of the service itself ended the job; its log says more",
    )
