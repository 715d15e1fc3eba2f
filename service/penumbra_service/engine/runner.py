"""One job from its plan to its picture: plan -> engine -> canvas -> stop or go on.

Threads: `run` blocks in the thread that calls it, which alone touches the canvas. The engine's thread calls
`next_lease` and `deliver`, which meet it at the desk and in a queue. `halt` may be
called from anywhere. Callbacks come on the thread of `run`.
"""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import time
from collections.abc import Callable
from typing import Final

from penumbra_kernels.nodes import Tile
from penumbra_scene.check import scene_hash
from penumbra_scene.job import JobState, Progress, StopReason

from penumbra_service.engine import snapshot
from penumbra_service.engine.canvas import Canvas
from penumbra_service.engine.clock import TraceClock
from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.pace import Pace
from penumbra_service.engine.progress import Now, forecast, progress_of
from penumbra_service.engine.protocol import (
    DeviceDescription,
    Engine,
    Lease,
    LeaseFailure,
    LeaseLost,
    LeaseResult,
    NoDevice,
    RenderSpec,
    SceneLoaded,
    ToJob,
)
from penumbra_service.engine.snapshot import Snapshot, is_full, kernel_hash
from penumbra_service.engine.stages import PILOT_SHARE, Stages
from penumbra_service.engine.task import Failure, Halt, RenderTask, RunFailedError, RunResult
from penumbra_service.engine.trust import Trust
from penumbra_service.film.film import Film
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.predict import fit_theta
from penumbra_service.film.preview import PreviewImage
from penumbra_service.film.replicates import choose_layout
from penumbra_service.film.stop import MIN_CHECK_SAMPLES
from penumbra_service.film.tilefile import FolderTileStore
from penumbra_service.jobs.batches import Batches
from penumbra_service.jobs.dispatch import gain_of
from penumbra_service.jobs.life import DeviceCrashed, Life, SceneReady, StopReached, WentWrong, step
from penumbra_service.jobs.planning import WorkItem
from penumbra_service.jobs.record import Effect, Foretold, RunRecord

__all__ = ["Failure", "Halt", "JobRunner", "RenderTask", "RunResult"]

log = logging.getLogger(__name__)

PROGRESS_SECONDS: Final = 0.25
"""Least time between two progress reports."""
PREVIEW_SECONDS: Final = 2.0
SNAPSHOT_SECONDS: Final = 5.0
SNAPSHOT_SHARE: Final = 20.0
"""A snapshot that took s seconds is followed by no other for 20 s of them: at most 5 % of the time goes
there."""
TICK_SECONDS: Final = 0.25
SPACE_SECONDS: Final = 5.0
"""Wait before a disk that was full is tried again."""
TILE_SIZE: Final = 64
LARGE_TILE_SIZE: Final = 128
GPU_TILE_SIZE: Final = 256
LARGE_WINDOW: Final = 2 * 1024 * 1024
"""Pixels from which tiles are larger, so that files stay few."""


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
        self._on_progress = on_progress
        self._on_preview = on_preview
        self._layout = task.layout or choose_layout(task.scene.sampler, task.scene.stop)
        window = task.scene.film.window
        self._window = Tile(window.x, window.y, window.width, window.height)
        self._pixels = window.width * window.height
        self._spec = self._make_spec()
        self._scene = self._spec.key
        self._key = f"{self._scene}-{kernel_hash()}"
        self._stages = Stages(task.scene, self._layout, self._window, task.folder, self._key)
        self._record = RunRecord()
        self._life = Life(JobState.COMPILING)
        self._theta = 1.0
        self._inbox: queue.SimpleQueue[tuple[DeviceDescription, ToJob] | None] = queue.SimpleQueue()
        self._halt: Halt | None = None
        self._told: tuple[JobState, Progress] | None = None
        self._last_progress = self._last_preview = -math.inf
        self._clock = TraceClock(0.0)
        self._reason: str | None = None
        self._full_before: RunRecord | None = None
        """What was known when the disk was full."""
        self._desk = LeaseDesk(
            task.job,
            self._spec,
            hungry=lambda: self._inbox.put(None),
            strict=task.strict,
            verify=task.verify,
            busy=lambda busy: self._clock.busy(busy),
            name=task.name,
        )
        self._bid()

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
        return self._gain

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
                    return RunResult(state, self._record, StopReason.CANCELLED if state.ended else None)
        except RunFailedError as failed:
            return self._fail(failed.failure)
        except OSError as error:
            log.exception("job %s: its folder cannot be used", self.job)
            return self._fail(Failure("storage", f"the job's files cannot be read or written: {error}"))
        finally:
            self._desk.close()
            self._engine.detach(self)

    def _attempt(self) -> RunResult:
        self._prepare()
        self._engine.attach(self)
        return self._loop()

    def _suspend(self) -> None:
        """Let go of all that is not on disk, and wait a while."""
        self._engine.detach(self)
        self._desk.wind_up()
        self._reason = None
        self._full_before = self._record
        end = time.monotonic() + SPACE_SECONDS
        while self._halt is None and time.monotonic() < end:
            with contextlib.suppress(queue.Empty):
                self._inbox.get(timeout=TICK_SECONDS)

    def _make_spec(self) -> RenderSpec:
        task = self._task
        return RenderSpec(
            scene_path=str((task.folder / "scene.json").resolve()),
            scene_hash=scene_hash(task.scene),
            assets_folder=None if task.assets_folder is None else str(task.assets_folder.resolve()),
            scene_folder=None if task.scene_folder is None else str(task.scene_folder.resolve()),
            time=task.time,
            replicates=self._layout.replicates,
            strata=self._layout.strata,
            program=task.program,
            decode=task.decode,
        )

    def _prepare(self) -> None:
        """Read the snapshot, if there is one, and plan what it lacks."""
        scene = self._task.scene.model_dump_json().encode()
        FolderTileStore(self._task.folder).write("scene.json", scene)
        self._stage, found = self._stages.resume()
        kept = found or self._fresh()
        self._record = kept.record
        self._tell_resumed(kept)
        self._life = Life(JobState.COMPILING, kept.record.crashes)
        self._clock = TraceClock(kept.record.seconds)
        self._tile_size = kept.tile_size
        self._trust = Trust(kept.record, self._desk, self._engine.usable)
        self._checked_before = kept.record.checked_leases
        if kept.record.bit_class not in ("none", "mixed"):
            self._desk.keep_to(kept.record.bit_class)
        self._set_up(kept.checked, kept.open_ends)
        self._next_snapshot = time.monotonic() + SNAPSHOT_SECONDS

    def _set_up(self, checked: int, open_ends: tuple[int, ...], *, anew: bool = False) -> None:
        """Get to work on the stage: with the batches that were begun, and the tiles that are there. `anew`: it keeps
        nothing of the stage before."""
        stage, task = self._stage, self._task
        batches = Batches(stage.rule, checked, ends=self._record.ends)
        batches.reopen(open_ends)
        film = Film(
            TileGrid(self._window, self._tile_size),
            self._layout.replicates,
            stage.store,
            stage.key,
            deterministic=self._layout.deterministic,
            memory_limit=task.memory_limit,
        )
        layers = bool(task.scene.film.layers)
        self._canvas = Canvas(film, batches, self._record, stage.levels, layers=layers)
        self._pace = Pace(self._clock.seconds, self._canvas.samples)
        if task.scene.adaptive is not None:
            self._desk.share(stage.levels, stage.allotment, anew=anew)
        self._plan(self._canvas.missing())

    def _tell_resumed(self, kept: Snapshot) -> None:
        """Have the receipt tell that work which no snapshot holds is done again."""
        record = kept.record
        record.resumed += bool(kept.checked or kept.open_ends)
        if self._full_before is not None:
            record.redone_leases += self._full_before.leases - record.leases
            told = "the disk was full: the render waited, and went on from its last snapshot"
            record.warnings += [told] if told not in record.warnings else []
            self._full_before = None

    def _fresh(self) -> Snapshot:
        """A run from the start: whatever lies in the folder is of no use."""
        self._stages.clear()
        layout = self._layout
        record = RunRecord(
            layout.replicates, self._stage.strata, layout.deterministic, kernel_hash=kernel_hash()
        )
        return Snapshot(self._stage.key, self._choose_tile_size(), 0, (), record)

    def _choose_tile_size(self) -> int:
        if self._pixels >= LARGE_WINDOW / 2 and any(device.kind == "gpu" for device in self._engine.usable()):
            return GPU_TILE_SIZE
        return LARGE_TILE_SIZE if self._pixels >= LARGE_WINDOW else TILE_SIZE

    def _loop(self) -> RunResult:
        while True:
            if self._reason is None:
                self._reason = self._advance()
            if self._reason is not None and not self._unsure():
                return self._finish(self._reason)
            self._hear()
            if self._halt is not None:
                return self._halted(self._halt)
            if self._reason is None and self._overdue():
                self._reason = "seconds"
                continue
            self._tell()
            self._keep()

    def _overdue(self) -> bool:
        return self._canvas.batches.overdue(self._clock.seconds, self._remaining_seconds)

    def _unsure(self) -> bool:
        """Whether to wait for checks that devices are still at, now that the picture is there."""
        self._desk.wind_up()
        if self._desk.doubts(self._engine.usable()):
            return True
        self._trust.settle()
        return False

    def _hear(self) -> None:
        """Wait for news and take in all that is there."""
        try:
            entry = self._inbox.get(timeout=TICK_SECONDS)
            while True:
                if entry is not None:
                    self._take(*entry)
                entry = self._inbox.get_nowait()
        except queue.Empty:
            return

    def _take(self, device: DeviceDescription, event: ToJob) -> None:
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

    def _take_result(self, device: DeviceDescription, result: LeaseResult) -> None:
        if not self._trust.believes(device):
            self._give_back(result.lease)
            return
        wrong = self._desk.checked(result, device)
        if wrong is not None:
            self._take_check(device, result, wrong)
            return
        if not self._desk.answered(result, device):
            return
        self._clock.start()
        self._trust.delivered(device, result)
        before = self._canvas.samples
        self._canvas.take(result.nodes)
        self._pace.deliver(self._clock.seconds, self._canvas.samples - before)
        self._bid()

    def _take_check(self, device: DeviceDescription, result: LeaseResult, wrong: list[str]) -> None:
        """Another device has done a lease that is there already."""
        self._trust.spent(device, result)
        self._record.checked_leases = self._checked_before + self._desk.checks
        for other in wrong:
            self._canvas.discard(self._trust.disbelieve(other))
        if wrong and self._reason is not None:
            self._reason = None
            self._canvas.look_again()
        self._engine.wake()

    def _bid(self) -> None:
        """What a second of a device is worth here, after what it has cost so far."""
        points = self._record.points
        error = points[-1].relmse if points else math.nan
        self._gain = gain_of(error, self._theta, self._record.trace_seconds)

    def _take_scene(self, device: DeviceDescription, loaded: SceneLoaded) -> None:
        record = self._record
        self._clock.start()
        self._life, _ = step(self._life, SceneReady())
        record.build_seconds += loaded.build_seconds
        record.compile_seconds += loaded.compile_seconds
        record.build_warm = loaded.build_warm and record.build_warm is not False
        record.compile_warm = loaded.compile_warm and record.compile_warm is not False
        record.effects = [Effect(*effect) for effect in loaded.effects]
        record.program_hash = loaded.program_hash
        self._trust.use_of(device)
        self._tell(force=True)

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
        self._record.redone_leases += 1
        self._engine.wake()
        return tried

    def _crashed(self, device: DeviceDescription, reason: str, tried: frozenset[str]) -> None:
        self._life, _ = step(self._life, DeviceCrashed(reason))
        self._record.crashes = self._life.crashes
        try:
            self._trust.failed(device, reason, tried)
        finally:
            self._save()

    def _advance(self) -> str | None:
        """Open batches, and check the current one where it is complete; why to stop, if so."""
        while True:
            self._plan(self._canvas.take_lost())
            self._open()
            if self._canvas.batches.current is None:
                return "seconds"  # the time rule leaves no room for another batch
            if not self._canvas.complete:
                return None
            reason = self._canvas.check(self._clock.seconds, self._stage.rule.confidence)
            self._theta = fit_theta(self._record.points).theta
            self._tell(force=True)
            if self._stage.pilot and (reason is not None or self._pilot_has_lasted):
                self._begin_picture()
                continue
            if reason is not None:
                return reason
            self._demand_hope()
            self._foretell()
            self._save()
            self._canvas.proceed()

    @property
    def _pilot_has_lasted(self) -> bool:
        limit = self._task.scene.stop.seconds
        return limit is not None and self._clock.seconds >= PILOT_SHARE * limit

    def _begin_picture(self) -> None:
        """The pilot has decided: the map first, then the state, then work that depends on them."""
        pilot = self._stage
        end = self._canvas.settle()
        self._canvas.flush()
        self._record.seconds = self._clock.seconds
        self._stage = self._stages.decide(self._canvas.film, self._record, end)
        self._record.strata = self._stage.strata
        checked = 0 if pilot.own_numbers else end
        snapshot.save(
            self._stage.store, Snapshot(self._stage.key, self._tile_size, checked, (), self._record)
        )
        before = self._canvas.preview
        self._set_up(checked, (), anew=pilot.own_numbers)
        self._canvas.preview = before
        if pilot.own_numbers:
            self._stages.drop_pilot()

    def _demand_hope(self) -> None:
        """A target alone never ends a render of which no sample counts: its error stays unknown."""
        rule, counts = self._stage.rule, self._record.counts
        if rule.relative_error is None or rule.samples is not None or rule.seconds is not None:
            return
        if counts is not None and counts.taken == 0 and counts.rejected >= MIN_CHECK_SAMPLES * counts.pixels:
            what = f"all {counts.rejected} samples were NaN, infinite or negative"
            raise RunFailedError(
                "scene", f"{what}, so that no error can be estimated: are numbers too large?"
            )

    def _open(self) -> None:
        """One more batch where the devices would run dry. There is always one to be checked next: work that waits may
        be of batches which are complete, since that of a discarded tile is planned anew beside what was under way."""
        self._desk.allowed(self._engine.usable())
        while self._desk.idle or self._canvas.batches.current is None:
            if self._stage.pilot and self._canvas.batches.current is not None:
                return  # what a pilot renders past its end could not be kept
            per_index = self._pixels * self._layout.replicates * self._stage.density
            open_samples = self._desk.out_samples / per_index
            rate = self._rate()
            left = self._canvas.batches.seconds_left(self._clock.seconds, open_samples, rate)
            items = self._canvas.open_next(rate, left)
            if items is None:
                return
            self._save()
            self._plan(items)

    def _plan(self, items: list[WorkItem]) -> None:
        if items:
            self._desk.add(items)
            self._engine.wake()

    def _rate(self) -> float | None:
        """Indices of the axis of samples per second, of the whole picture."""
        rate = self._pace.rate
        return rate / (self._layout.replicates * self._stage.density) if rate else None

    def _foretell(self) -> None:
        record = self._record
        if record.foretold is not None:
            return
        if self._stage.rule.relative_error is not None and not fit_theta(record.points).points:
            return
        told = forecast(self._stage.rule, record.points, self._now())
        if told is not None:
            record.foretold = Foretold(record.points[-1].samples, told.samples, told.seconds)

    def _remaining_seconds(self) -> float:
        """What the current batch still takes."""
        rate = self._rate()
        return math.inf if rate is None else self._canvas.missing_samples() / rate

    def _now(self, *, done: bool = False) -> Now:
        """`done`: only samples that make up the picture count, as in the receipt; work ahead is dropped."""
        rate = self._pace.rate
        counts = self._record.counts
        samples = counts.taken / counts.pixels if done and counts and counts.pixels else self._canvas.samples
        if self._stage.own_numbers:
            samples = 0.0  # a pilot that is dropped is no part of the picture
        return Now(samples, self._clock.seconds, 1 / rate if rate else None)

    def _tell(self, force: bool = False, share: float = 0.0) -> None:
        """Progress and preview, if it is time: for the first preview it always is."""
        now = time.monotonic()
        first = self._canvas.preview.changed and self._last_preview == -math.inf
        if not (force or first) and now < self._last_progress + PROGRESS_SECONDS:
            return
        self._last_progress = now
        standing = self._now(done=share == 1.0)
        goal = self._stage.goal
        told = forecast(goal, self._record.points, standing)
        before = 0.0 if self._told is None else self._told[1].progress
        progress = progress_of(goal, self._record, told, standing, max(before, share))
        news = (self._life.state, progress)
        if news != self._told:
            self._told = news
            self._on_progress(*news)
        if self._canvas.preview.changed and (share == 1.0 or now >= self._last_preview + PREVIEW_SECONDS):
            self._last_preview = now
            self._on_preview(self._canvas.preview.image())

    def _keep(self) -> None:
        """A snapshot, if it is time."""
        started = time.monotonic()
        if self._canvas.changed and started >= self._next_snapshot:
            self._save()
            self._canvas.flush()
            taken = time.monotonic() - started
            self._next_snapshot = time.monotonic() + max(SNAPSHOT_SECONDS, SNAPSHOT_SHARE * taken)

    def _save(self) -> None:
        """The state without the sums. It must be on disk before any tile that depends on it."""
        self._record.seconds = self._clock.seconds
        batches = self._canvas.batches
        kept = Snapshot(self._stage.key, self._tile_size, batches.checked, batches.open_ends, self._record)
        snapshot.save(self._stage.store, kept)

    def _finish(self, reason: str) -> RunResult:
        """The picture is there."""
        self._desk.close()
        self._clock.stop()
        self._record.seconds = self._clock.seconds
        end = self._canvas.settle()
        self._life, _ = step(self._life, StopReached())
        self._tell(force=True, share=1.0)
        layers = self._task.scene.film.layers
        why = StopReason(reason)
        return RunResult(self._life.state, self._record, why, film=self._canvas.film, end=end, layers=layers)

    def _halted(self, halt: Halt) -> RunResult:
        self._desk.close()
        self._clock.stop()
        self._record.seconds = self._clock.seconds
        if halt is Halt.CANCEL:
            return RunResult(JobState.CANCELLED, self._record, StopReason.CANCELLED)
        self._save()
        self._canvas.flush()
        return RunResult(JobState.PAUSED, self._record)

    def _fail(self, failure: Failure) -> RunResult:
        self._desk.close()
        if not self._life.state.ended:
            self._life, _ = step(self._life, WentWrong(failure.message))
        return RunResult(JobState.FAILED, self._record, StopReason.FAILED, failure)
