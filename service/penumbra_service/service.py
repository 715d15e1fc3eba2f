"""The render service without HTTP: takes jobs in, runs them, survives restarts, tells whoever watches.

A job waits in the ledger, from which the queue (job_queue.py) takes it: higher priority first, then older. Cancelling,
pausing and overtaking are all done by asking the runner to stop: it leaves a snapshot, from which the job can go on.
"""

from __future__ import annotations

import threading
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from penumbra_scene.errors import ProblemError, make_problem
from penumbra_scene.job import JobRequest, JobState, StopReason
from penumbra_scene.parse import job_from_json, parse_json
from penumbra_scene.quote import Quote

from penumbra_service.housekeeping import QUOTE_PREFIX, Housekeeper
from penumbra_service.images.assets import FolderAssets
from penumbra_service.images.limits import DecodeLimits
from penumbra_service.job_limits import within
from penumbra_service.job_queue import ACTIVE, OPEN, WAITING, JobQueue
from penumbra_service.running import Halt, Runner
from penumbra_service.settings import Settings
from penumbra_service.status import initial_progress
from penumbra_service.store.artifacts import Artifacts
from penumbra_service.store.assets import AssetStore
from penumbra_service.store.database import Database
from penumbra_service.store.frames import FrameStore
from penumbra_service.store.jobs import JobRow, JobStore, NewJob, SqlJobStore
from penumbra_service.store.keys import ApiKey, KeyStore
from penumbra_service.watchers import Watchers

QUOTE_WAIT_SECONDS: Final = 30.0
"""A quote waits at most so long for others to be made."""


class ConflictError(Exception):
    """The job is in a state that does not allow this."""

    def __init__(self, job: JobRow, action: str, allowed: str) -> None:
        super().__init__(f"job {job.id} is {job.state}; to {action} it, it must be {allowed}")


class QueueFullError(Exception):
    """Too many jobs wait."""

    def __init__(self, limit: int) -> None:
        super().__init__(
            f"{limit} jobs wait already, which is the limit; try again when some of them are done"
        )


class QuotaUsedError(Exception):
    """The key has no device-seconds left."""

    def __init__(self, key: ApiKey) -> None:
        super().__init__(
            f"the key {key.name!r} has a quota of {key.quota_seconds:g} device-seconds and has used "
            f"{key.used_seconds:.1f}; whoever keeps the service can raise it: penumbra keys quota"
        )


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
        self._quoting = threading.Lock()
        self.queue = JobQueue(
            settings,
            self.jobs,
            self.frames,
            self.artifacts,
            self.watchers,
            runner,
            request=self.request,
            spent=self._spent,
        )
        self.housekeeper = Housekeeper(settings, self.jobs, self.artifacts, self.asset_store)
        self.device_seconds = 0.0
        """That the jobs of this process have used."""

    def start(self) -> None:
        """Puts what an earlier process left running back into the queue, and begins to work."""
        self.housekeeper.start()
        self.runner.start()
        self.queue.start()

    def stop(self) -> None:
        """Has the running jobs write their snapshots, then ends."""
        self.housekeeper.stop()
        self.queue.stop()
        self.runner.stop()
        self.database.close()

    @property
    def needs_key(self) -> bool:
        """Whether callers must show a key: others can reach the service, or a key was ever made."""
        return self.settings.public or self.keys.any_made()

    def submit(self, job: NewJob) -> tuple[JobRow, bool]:
        """The job and whether it is new. Raises store.jobs.IdempotencyConflictError, QueueFullError,
        QuotaUsedError."""
        row, created = self.jobs.create(job, self._check_room)
        if created:
            self.queue.changed(row)
        return row, created

    def _check_room(self, job: NewJob) -> None:
        """Called for jobs that are new: a submission that is repeated finds its job whatever has become full."""
        self._check_quota(job.owner)
        limit = self.settings.max_queued_jobs
        if self.jobs.count(WAITING) >= limit:
            raise QueueFullError(limit)

    def _check_quota(self, owner: str | None) -> None:
        key = None if owner is None else self.keys.get(owner)
        if key is not None and key.exhausted:
            raise QuotaUsedError(key)

    def _spent(self, row: JobRow, device_seconds: float) -> bool:
        """Whether the job's key has no more."""
        self.device_seconds += device_seconds
        if row.owner is None:
            return False
        if device_seconds > 0:
            self.keys.charge(row.owner, device_seconds)
        key = self.keys.get(row.owner)
        return key is not None and key.exhausted

    def quote(self, request: JobRequest) -> Quote:
        """What a job would cost on the devices at hand. One quote at a time: others wait for it.

        Raises ProblemError: 503 where the wait is too long, 422 and 5xx as for a job that fails.
        """
        if not self._quoting.acquire(timeout=QUOTE_WAIT_SECONDS):
            detail = f"other quotes took more than {QUOTE_WAIT_SECONDS:g} s; ask again"
            raise ProblemError(make_problem("busy", "Other quotes are being made", 503, detail))
        try:
            self.settings.work_folder.mkdir(parents=True, exist_ok=True)
            with TemporaryDirectory(prefix=QUOTE_PREFIX, dir=self.settings.work_folder) as folder:
                return self.runner.quote(within(request, self.settings), Path(folder))
        finally:
            self._quoting.release()

    def cancel(self, job_id: str) -> JobRow:
        """Ends a job; one that is cancelled already stays so. Raises NoSuchJobError, ConflictError."""
        now = datetime.now(UTC)
        before = self.jobs.get(job_id).state
        row = self.jobs.move(job_id, OPEN, JobState.CANCELLED, finished=now, reason=StopReason.CANCELLED)
        if row is None:
            row = self.jobs.get(job_id)
            if row.state != JobState.CANCELLED:
                raise ConflictError(row, "cancel", "queued, running or paused")
        self.queue.halt(job_id, Halt.CANCEL)
        elsewhere = self.settings.shared and before in ACTIVE  # who runs it cleans up after it
        if not elsewhere and not self.queue.has(job_id):
            self.queue.clean(job_id)
        self.queue.changed(row)
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
        self.queue.halt(job_id, Halt.PAUSE)
        self.queue.changed(row)
        return row

    def resume(self, job_id: str) -> JobRow:
        """Puts a paused job back into the queue. Raises NoSuchJobError, ConflictError, QuotaUsedError."""
        row = self.jobs.get(job_id)
        if row.state == JobState.PAUSED:
            self._check_quota(row.owner)
        row = self.jobs.move(job_id, (JobState.PAUSED,), JobState.QUEUED, reason=None) or self.jobs.get(
            job_id
        )
        if JobState(row.state).ended:
            raise ConflictError(row, "resume", "paused")
        self.queue.changed(row)
        return row

    def prioritize(self, job_id: str, priority: int) -> JobRow:
        """Moves a job in the queue. Raises NoSuchJobError, ConflictError."""
        row = self.jobs.get(job_id)
        if JobState(row.state).ended:
            raise ConflictError(row, "re-prioritise", "queued, running or paused")
        row = self.jobs.set(job_id, priority=priority)
        self.queue.changed(row)
        return row

    def request(self, job_id: str) -> JobRequest:
        """What is rendered: what was asked for, with the end that this service sets it. Raises NoSuchJobError."""
        text = self.jobs.request(job_id).encode()
        # Its length was checked when it came; as it is kept, numbers may be longer (1e9 is 1000000000.0).
        return within(job_from_json(parse_json(text, len(text))), self.settings)

    def work_folder(self, job_id: str) -> Path:
        """Where a job keeps snapshots and unfinished files."""
        return self.queue.work_folder(job_id)


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
