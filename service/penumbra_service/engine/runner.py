"""One job from its plan to its picture: plan -> engine -> film -> stop or go on.

Threads: `run` blocks in the thread that calls it, which alone touches the film. The engine's thread calls
`next_lease` and `deliver`, which take a lock for the planner and put news into a queue. `halt` may be called
from anywhere. Callbacks come on the thread of `run`.
"""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from penumbra_kernels.nodes import Tile
from penumbra_scene.check import scene_hash
from penumbra_scene.job import JobState, Progress, StopReason
from penumbra_scene.scene import Scene

from penumbra_service.engine import snapshot
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
from penumbra_service.engine.snapshot import Snapshot, kernel_hash
from penumbra_service.film.develop import Developed, develop_bands
from penumbra_service.film.error import TileSummary, image_error
from penumbra_service.film.film import MEMORY_LIMIT, Film
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.predict import Point, fit_theta
from penumbra_service.film.preview import Preview, PreviewImage
from penumbra_service.film.replicates import Layout, choose_layout
from penumbra_service.film.stop import StopRule
from penumbra_service.film.tilefile import FolderTileStore
from penumbra_service.jobs.batches import Batches
from penumbra_service.jobs.life import DeviceCrashed, Life, SceneReady, StopReached, WentWrong, step
from penumbra_service.jobs.planning import LeasePlanner, WorkItem
from penumbra_service.jobs.record import DeviceUse, Effect, Foretold, PixelCounts, RunRecord

log = logging.getLogger(__name__)

PROGRESS_SECONDS: Final = 0.25
"""Least time between two progress reports."""
PREVIEW_SECONDS: Final = 2.0
SNAPSHOT_SECONDS: Final = 5.0
SNAPSHOT_SHARE: Final = 20.0
"""A snapshot that took s seconds is followed by no other for 20 s of them: at most 5 % of the time goes
there."""
TICK_SECONDS: Final = 0.25
MIN_DEADLINE: Final = 60.0
UNKNOWN_DEADLINE: Final = 600.0
"""For a device's first lease on a job, of which only the samples are known."""
DEADLINE_FACTOR: Final = 20.0
TILE_SIZE: Final = 64
LARGE_TILE_SIZE: Final = 128
GPU_TILE_SIZE: Final = 256
LARGE_WINDOW: Final = 2 * 1024 * 1024
"""Pixels from which tiles are larger, so that files stay few."""


class Halt(StrEnum):
    """Why a run is asked to end early."""

    PAUSE = "pause"
    """Keep a snapshot: another run can go on."""
    CANCEL = "cancel"
    """Keep nothing."""


@dataclass(frozen=True)
class RenderTask:
    """A job to run."""

    job: str
    scene: Scene
    """As it is to be rendered."""
    folder: Path
    """The job's own; a snapshot in it is continued."""
    assets_folder: Path | None = None
    """Assets by content."""
    scene_folder: Path | None = None
    """What `file` references are relative to; None: they are refused."""
    time: float = 0.0
    """Seconds: when the scene is looked at."""
    priority: int = 0
    program: str = "specialised"
    memory_limit: int = MEMORY_LIMIT


@dataclass(frozen=True)
class Failure:
    """Why a run failed. kind: 'scene', 'build', 'crash', 'device', 'storage'."""

    kind: str
    message: str


@dataclass(frozen=True)
class RunResult:
    """How a run ended. state: FINISHING (the picture is there, to be written), PAUSED, CANCELLED or
    FAILED."""

    state: JobState
    record: RunRecord
    reason: StopReason | None = None
    failure: Failure | None = None
    film: Film | None = None
    end: int = 0
    """Samples a replicate that make the picture."""
    layers: tuple[str, ...] = ()

    def bands(self) -> Iterator[Developed]:
        """The picture's channels, as bands of scanlines from the top."""
        assert self.film is not None
        return develop_bands(self.film, self.end, self.layers)


class _RunFailedError(Exception):
    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.failure = Failure(kind, message)


class JobRunner:
    """Runs one RenderTask on an engine, once. Implements protocol.LeaseSource."""

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
        self._on_progress = on_progress
        self._on_preview = on_preview
        self._layout: Layout = choose_layout(task.scene.sampler, task.scene.stop)
        window = task.scene.film.window
        self._window = Tile(window.x, window.y, window.width, window.height)
        self._lock = threading.Lock()
        self._inbox: queue.SimpleQueue[tuple[DeviceDescription, ToJob] | None] = queue.SimpleQueue()
        self._halt: Halt | None = None
        self._closed = False
        self._hungry = False
        self._excluded: dict[str, str] = {}
        self._numbers: dict[str, int] = {}

    @property
    def job(self) -> str:
        return self._task.job

    @property
    def priority(self) -> int:
        return self._task.priority

    def halt(self, reason: Halt) -> None:
        """Ask the run to end; it does within a moment, and devices are through with it within two leases."""
        if self._halt is not Halt.CANCEL:
            self._halt = reason
        self._inbox.put(None)

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """Work for a device (engine's thread)."""
        with self._lock:
            if self._closed or device.id in self._excluded:
                return None
            planned = self._planner.take(device.id)
            if planned is None:
                if not self._hungry:
                    self._hungry = True
                    self._inbox.put(None)
                return None
            expected = self._planner.expected_seconds(device.id, planned)
            deadline = UNKNOWN_DEADLINE if expected is None else max(MIN_DEADLINE, DEADLINE_FACTOR * expected)
            lease_id = f"{self.job}/{planned.number}"
            self._numbers[lease_id] = planned.number
            return Lease(lease_id, self.job, self._spec, planned.items, deadline)

    def deliver(self, device: DeviceDescription, event: ToJob) -> None:
        """News for the run (engine's thread)."""
        self._inbox.put((device, event))

    def run(self) -> RunResult:
        """Render, from the snapshot in the task's folder if there is one. Blocks until the picture is there,
        the run has failed, or `halt` was asked for."""
        try:
            self._prepare()
            self._engine.attach(self)
            return self._loop()
        except _RunFailedError as failed:
            return self._fail(failed.failure)
        except OSError as error:
            log.exception("job %s: its folder cannot be used", self.job)
            return self._fail(Failure("storage", f"the job's files cannot be read or written: {error}"))
        finally:
            self._close()
            self._engine.detach(self)

    def _prepare(self) -> None:
        task, layout = self._task, self._layout
        folder = task.folder
        folder.mkdir(parents=True, exist_ok=True)
        store = FolderTileStore(folder / "tiles")
        digest = scene_hash(task.scene)
        FolderTileStore(folder).write("scene.json", task.scene.model_dump_json().encode())
        self._spec = RenderSpec(
            scene_path=str((folder / "scene.json").resolve()),
            scene_hash=digest,
            assets_folder=None if task.assets_folder is None else str(task.assets_folder.resolve()),
            scene_folder=None if task.scene_folder is None else str(task.scene_folder.resolve()),
            time=task.time,
            replicates=layout.replicates,
            strata=layout.strata,
            program=task.program,
        )
        self._store = store
        self._life = Life(JobState.COMPILING)
        self._key = f"{self._spec.key}-{kernel_hash()}"
        stop = task.scene.stop
        self._rule = StopRule(
            layout.replicates,
            layout.samples_per_replicate,
            stop.seconds,
            stop.relative_error,
            stop.confidence,
        )
        self._planner = LeasePlanner(layout.replicates)
        self._restore(snapshot.load(store, self._key))
        self._preview = Preview(self._window)
        self._summaries: dict[Tile, TileSummary] = {}
        self._clock_started: float | None = None
        self._share = 0.0
        self._told: tuple[JobState, Progress] | None = None
        self._last_progress = self._last_preview = -math.inf
        self._next_snapshot = time.monotonic() + SNAPSHOT_SECONDS
        self._film_changed = False
        self._samples_done = self._count_samples()
        self._summarize_complete()

    def _restore(self, kept: Snapshot | None) -> None:
        layout = self._layout
        if kept is None:
            for name in self._store.names():
                self._store.delete(name)
            record = RunRecord(
                replicates=layout.replicates, strata=layout.strata, deterministic=layout.deterministic
            )
            record.kernel_hash = kernel_hash()
            kept = Snapshot(self._key, self._choose_tile_size(), 0, (), record)
        self._record = kept.record
        self._life = Life(JobState.COMPILING, self._record.crashes)
        self._batches = Batches(self._rule, kept.checked, ends=self._record.ends)
        self._batches.reopen(kept.open_ends)
        self._tile_size = kept.tile_size
        self._film = Film(
            TileGrid(self._window, kept.tile_size),
            layout.replicates,
            self._store,
            self._key,
            deterministic=layout.deterministic,
            memory_limit=self._task.memory_limit,
        )
        self._film.restore(self._batches.barriers)
        for first, end in self._batches.ranges:
            self._planner.add(self._items(first, end))

    def _choose_tile_size(self) -> int:
        pixels = self._window.width * self._window.height
        if pixels >= LARGE_WINDOW / 2 and any(device.kind == "gpu" for device in self._engine.usable()):
            return GPU_TILE_SIZE
        return LARGE_TILE_SIZE if pixels >= LARGE_WINDOW else TILE_SIZE

    def _count_samples(self) -> int:
        return sum(
            count * self._layout.replicates * tile.width * tile.height
            for tile in self._film.tiles
            for _, count in self._film.ranges(tile)
        )

    def _loop(self) -> RunResult:
        while True:
            reason = self._advance()
            if reason is not None:
                return self._finish(reason)
            self._hear()
            if self._halt is not None:
                return self._halted(self._halt)
            if self._batches.overdue(self._seconds(), self._remaining_seconds):
                return self._finish("seconds")
            self._tell()
            self._keep()

    def _hear(self) -> None:
        """Wait for news and take in all that is there."""
        try:
            entry = self._inbox.get(timeout=TICK_SECONDS)
            while True:
                if entry is not None and not self._closed:
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
                self._give_back(lease)
                if blamed:
                    self._crashed(reason)
            case LeaseFailure():
                self._take_failure(device, event)
            case NoDevice(reason):
                raise _RunFailedError("device", reason)

    def _take_result(self, device: DeviceDescription, result: LeaseResult) -> None:
        with self._lock:
            number = self._numbers.pop(result.lease, None)
            planned = None if number is None else self._planner.done(number, device.id, result.seconds)
        if planned is None:
            return
        self._start_clock()
        use = self._use_of(device)
        use.leases += 1
        use.seconds += result.seconds
        self._record.trace_seconds += result.seconds
        for node in result.nodes:
            if self._film.add(node):
                self._samples_done += node.sums.size * node.sample_count
                self._film_changed = True
        for tile in {node.tile for node in result.nodes}:
            self._summarize(tile)
        self._mend_lost()

    def _take_scene(self, device: DeviceDescription, loaded: SceneLoaded) -> None:
        record = self._record
        self._start_clock()
        self._life, _ = step(self._life, SceneReady())
        record.build_seconds += loaded.build_seconds
        record.compile_seconds += loaded.compile_seconds
        record.build_warm = loaded.build_warm and record.build_warm is not False
        record.compile_warm = loaded.compile_warm and record.compile_warm is not False
        record.effects = [Effect(*effect) for effect in loaded.effects]
        record.program_hash = loaded.program_hash
        self._use_of(device)
        self._tell(force=True)

    def _take_failure(self, device: DeviceDescription, failure: LeaseFailure) -> None:
        if failure.kind == "scene":
            raise _RunFailedError("scene", failure.message)
        self._give_back(failure.lease)
        if failure.kind != "build":
            self._crashed(f"device {device.id}: {failure.message}")
            return
        with self._lock:
            self._excluded[device.id] = failure.message
            self._planner.devices = max(len(self._others()), 1)
        if not self._others():
            raise _RunFailedError("build", failure.message)
        self._record.warnings.append(f"device {device.id} was left out: {failure.message.splitlines()[0]}")

    def _others(self) -> list[DeviceDescription]:
        return [device for device in self._engine.usable() if device.id not in self._excluded]

    def _give_back(self, lease: str) -> None:
        with self._lock:
            number = self._numbers.pop(lease, None)
            if number is not None:
                self._planner.lost(number)
        self._record.redone_leases += 1
        self._engine.wake()

    def _crashed(self, reason: str) -> None:
        self._life, _ = step(self._life, DeviceCrashed(reason))
        self._record.crashes = self._life.crashes
        self._save()
        if self._life.state is JobState.FAILED:
            raise _RunFailedError("crash", self._life.reason or reason)

    def _use_of(self, device: DeviceDescription) -> DeviceUse:
        key = f"{device.id} {device.bit_class}"
        if key not in self._record.devices:
            self._record.devices[key] = DeviceUse(
                device.id, device.name, device.platform, device.driver, device.bit_class
            )
        return self._record.devices[key]

    def _mend_lost(self) -> None:
        """Tiles whose file broke while it was not in memory start again."""
        for tile in self._film.take_lost():
            log.warning("job %s: the file of %s is broken, the tile starts again", self.job, tile)
            self._summaries.pop(tile, None)
            items = [item for first, end in self._batches.ranges for item in self._items(first, end, [tile])]
            with self._lock:
                self._planner.add(items)
            self._samples_done = self._count_samples()
            self._engine.wake()

    def _advance(self) -> str | None:
        """Open batches, and check the current one where it is complete; why to stop, if so."""
        while True:
            self._open()
            if self._batches.current is None:
                return "seconds"  # the time rule leaves no room for another batch
            if len(self._summaries) < len(self._film.tiles):
                return None
            reason = self._check()
            if reason is not None:
                return reason
            self._summarize_complete()

    def _open(self) -> None:
        """One more batch where the devices would run dry."""
        added = False
        with self._lock:
            self._hungry = False
            self._planner.devices = max(len(self._others()), 1)
            while self._planner.idle:
                rate = self._rate()
                open_samples = (self._planner.ready_samples + self._planner.out_samples) / self._pixels
                left = self._batches.seconds_left(self._seconds(), open_samples, rate)
                opened = self._batches.open_next(rate, left)
                if opened is None:
                    break
                self._film.set_barriers(self._batches.barriers)
                self._save()
                self._planner.add(self._items(*opened))
                added = True
        if added:
            self._summarize_complete()
            self._engine.wake()

    def _items(self, first: int, end: int, tiles: Sequence[Tile] = ()) -> list[WorkItem]:
        """What these tiles (default: all) lack of samples [first, end)."""
        film = self._film
        return [WorkItem(t, at, n) for t in tiles or film.tiles for at, n in film.missing(t, first, end)]

    @property
    def _pixels(self) -> int:
        """Pixels times replicates."""
        return self._window.width * self._window.height * self._layout.replicates

    def _rate(self) -> float | None:
        """Samples a replicate per second, of the whole picture."""
        rate = self._planner.rate
        return rate / self._pixels if rate else None

    def _summarize(self, tile: Tile) -> None:
        """A tile has new nodes: if it is complete up to the current end, pool its statistics."""
        end = self._batches.current
        if end is None or tile in self._summaries or not self._film.complete(tile, end):
            return
        pixels, summary = self._film.summary(tile, end)
        self._summaries[tile] = summary
        self._preview.put(pixels)

    def _summarize_complete(self) -> None:
        for tile in self._film.tiles:
            self._summarize(tile)
        self._mend_lost()

    def _check(self) -> str | None:
        """The current batch is complete: look at the picture."""
        end = self._batches.current
        assert end is not None
        summaries = [self._summaries[tile] for tile in self._film.tiles]
        error = image_error(summaries)
        confidence = self._task.scene.stop.confidence
        samples = end * self._layout.replicates
        upper = error.upper(confidence) if error.known else math.nan
        seconds = self._seconds()
        self._record.points.append(Point(samples, seconds, error.relmse, upper, error.deviation, error.mse))
        self._record.counts = _counts(summaries)
        reason = self._batches.check(seconds, error)
        if reason is None:
            self._foretell()
            self._save()
            self._film.set_barriers(self._batches.barriers)
            self._summaries.clear()
        self._tell(force=True)
        return reason

    def _foretell(self) -> None:
        record = self._record
        if record.foretold is not None:
            return
        if self._rule.relative_error is not None and not fit_theta(record.points).points:
            return
        told = forecast(self._rule, record.points, self._now())
        if told is not None:
            record.foretold = Foretold(record.points[-1].samples, told.samples, told.seconds)

    def _start_clock(self) -> None:
        if self._clock_started is None:
            self._clock_started = time.monotonic()

    def _seconds(self) -> float:
        """Of tracing, by the clock, over all runs of this job."""
        running = 0.0 if self._clock_started is None else time.monotonic() - self._clock_started
        return self._record.seconds + running

    def _stop_clock(self) -> None:
        self._record.seconds = self._seconds()
        self._clock_started = None

    def _remaining_seconds(self) -> float:
        """What the current batch still takes."""
        rate, end = self._rate(), self._batches.current
        if rate is None or end is None:
            return math.inf
        missing = sum(
            count * tile.width * tile.height
            for tile in self._film.tiles
            if tile not in self._summaries
            for _, count in self._film.missing(tile, self._batches.checked, end)
        )
        return missing / (self._window.width * self._window.height) / rate

    def _now(self) -> Now:
        rate = self._rate()
        done = self._samples_done / (self._window.width * self._window.height)
        return Now(done, self._seconds(), 1 / (rate * self._layout.replicates) if rate else None)

    def _tell(self, force: bool = False) -> None:
        """Progress and preview, if it is time."""
        now = time.monotonic()
        if not force and now < self._last_progress + PROGRESS_SECONDS:
            return
        self._last_progress = now
        standing = self._now()
        told = forecast(self._rule, self._record.points, standing)
        progress = progress_of(self._rule, self._record, told, standing, self._share)
        self._share = progress.progress
        news = (self._life.state, progress)
        if news != self._told:
            self._told = news
            self._on_progress(*news)
        if self._preview.changed and now >= self._last_preview + PREVIEW_SECONDS:
            self._last_preview = now
            self._on_preview(self._preview.image())

    def _keep(self) -> None:
        """A snapshot, if it is time."""
        started = time.monotonic()
        if self._film_changed and started >= self._next_snapshot:
            self._write_snapshot()
            taken = time.monotonic() - started
            self._next_snapshot = time.monotonic() + max(SNAPSHOT_SECONDS, SNAPSHOT_SHARE * taken)

    def _write_snapshot(self) -> None:
        self._save()
        self._film.flush()
        self._film_changed = False

    def _save(self) -> None:
        """The state without the sums. It must be on disk before any tile that depends on it."""
        was_running = self._clock_started is not None
        self._stop_clock()
        if was_running:
            self._start_clock()
        ends = self._batches.open_ends
        snapshot.save(
            self._store, Snapshot(self._key, self._tile_size, self._batches.checked, ends, self._record)
        )

    def _close(self) -> None:
        with self._lock:
            self._closed = True
            if hasattr(self, "_planner"):
                self._planner.drop()

    def _finish(self, reason: str) -> RunResult:
        """The picture is there."""
        self._close()
        self._stop_clock()
        end = self._batches.settle()
        self._film.set_barriers((end,))
        self._life, _ = step(self._life, StopReached())
        self._share = 1.0
        self._tell(force=True)
        if self._preview.changed:
            self._on_preview(self._preview.image())
        layers = self._task.scene.film.layers
        return RunResult(
            self._life.state, self._record, StopReason(reason), film=self._film, end=end, layers=layers
        )

    def _halted(self, halt: Halt) -> RunResult:
        self._close()
        self._stop_clock()
        if halt is Halt.CANCEL:
            return RunResult(JobState.CANCELLED, self._record, StopReason.CANCELLED)
        self._write_snapshot()
        return RunResult(JobState.PAUSED, self._record)

    def _fail(self, failure: Failure) -> RunResult:
        self._close()
        record = getattr(self, "_record", RunRecord())
        if hasattr(self, "_life") and not self._life.state.ended:
            self._life, _ = step(self._life, WentWrong(failure.message))
        return RunResult(JobState.FAILED, record, StopReason.FAILED, failure)


def _counts(summaries: list[TileSummary]) -> PixelCounts:
    counts = PixelCounts(
        taken=sum(s.taken for s in summaries),
        lit=sum(s.lit for s in summaries),
        rejected=sum(s.rejected for s in summaries),
        pixels=sum(s.all_pixels for s in summaries),
        flagged=sum(s.untrusted for s in summaries),
    )
    for summary in summaries:
        for name, count in summary.flagged.items():
            counts.flags[name] = counts.flags.get(name, 0) + count
        for name, count in summary.rejected_in.items():
            counts.rejected_in[name] = counts.rejected_in.get(name, 0) + count
    return counts
