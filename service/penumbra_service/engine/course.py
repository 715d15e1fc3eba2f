"""What a run renders next, how far it is, and when it is enough: stages, batches, the canvas and its snapshots.

One thread, the run's, but for `gain`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from penumbra_kernels.nodes import SumNode, Tile

from penumbra_service.engine import snapshot
from penumbra_service.engine.canvas import Canvas
from penumbra_service.engine.clock import TraceClock
from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.pace import Pace
from penumbra_service.engine.progress import Now, forecast
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.snapshot import Snapshot, kernel_hash
from penumbra_service.engine.stages import PILOT_SHARE, Stages
from penumbra_service.engine.task import RenderTask, RunFailedError
from penumbra_service.film.film import Film
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.predict import fit_theta, upper_at
from penumbra_service.film.replicates import Layout
from penumbra_service.film.stop import MIN_CHECK_SAMPLES
from penumbra_service.jobs.batches import Batches
from penumbra_service.jobs.dispatch import gain_of
from penumbra_service.jobs.planning import WorkItem
from penumbra_service.jobs.record import Foretold, RunRecord

SNAPSHOT_SECONDS: Final = 5.0
SNAPSHOT_SHARE: Final = 20.0
"""A snapshot that took s seconds is followed by no other for 20 s of them: at most 5 % of the time goes
there."""
TILE_SIZE: Final = 96
"""A look at the error, a lease and a launch each take a time of their own for every tile; larger ones leave the cache."""
LARGE_TILE_SIZE: Final = 128
GPU_TILE_SIZE: Final = 256
LARGE_WINDOW: Final = 2 * 1024 * 1024
"""Pixels from which tiles are larger, so that files stay few."""


class Course:
    """Of one run, over all of its attempts. `looked` is called when the error of the picture was looked at."""

    def __init__(
        self,
        engine: Engine,
        task: RenderTask,
        layout: Layout,
        key: str,
        desk: LeaseDesk,
        clock: TraceClock,
        looked: Callable[[], None],
    ) -> None:
        self._engine = engine
        self._task = task
        self._layout = layout
        self._desk = desk
        self.clock = clock
        self._looked = looked
        window = task.scene.film.window
        self._window = Tile(window.x, window.y, window.width, window.height)
        self._pixels = window.width * window.height
        self._stages = Stages(task.scene, layout, self._window, task.folder, key, task.fixed)
        self.record = RunRecord()
        self.reason: str | None = None
        """Why the picture is as it should be; None: it is not yet."""
        self._theta = 1.0
        self._unsaved = False
        """Whether batches were begun or looked at that the state on disk does not know."""
        self._full_before: RunRecord | None = None
        """What was known when the disk was full."""
        self._bid()

    def resume(self) -> None:
        """Read the snapshot, if there is one, and plan what it lacks."""
        self.stage, found = self._stages.resume()
        kept = found or self._fresh()
        self.record = kept.record
        self._tell_resumed(kept)
        self.clock.restart(kept.record.seconds)
        self._tile_size = kept.tile_size
        if kept.record.bit_class not in ("none", "mixed"):
            self._desk.keep_to(kept.record.bit_class)
        self._set_up(kept.checked, kept.open_ends)
        self._next_snapshot = time.monotonic() + SNAPSHOT_SECONDS

    def suspend(self) -> None:
        """The disk is full: the next attempt begins from the last snapshot."""
        self._desk.suspend()
        self.reason = None
        self._full_before = self.record

    def advance(self) -> None:
        """Open batches, and check the current one where it is complete; sets `reason` where the picture is there.
        Raises RunFailedError."""
        if self.reason is None:
            self.reason = self._advance()

    def take(self, nodes: Iterable[SumNode]) -> None:
        """Sums of a lease."""
        before = self.canvas.samples
        self.canvas.take(nodes)
        self._pace.deliver(self.clock.seconds, self.canvas.samples - before)
        self._bid()

    def discard(self, voided: Sequence[set[Tile] | None]) -> None:
        """Sums of these sets of tiles, or of all with None, are void; where there are any, the picture is not there
        any more."""
        for tiles in voided:
            self.canvas.discard(tiles)
        if voided and self.reason is not None:
            self.reason = None
            self.canvas.look_again()

    @property
    def overdue(self) -> bool:
        """Whether the seconds end before the current batch would."""
        return self.canvas.batches.overdue(self.clock.seconds, self._remaining_seconds)

    def standing(self, *, done: bool = False) -> Now:
        """`done`: only samples that make up the picture count, as in the receipt; work ahead is dropped."""
        rate = self._pace.rate
        counts = self.record.counts
        samples = counts.taken / counts.pixels if done and counts and counts.pixels else self.canvas.samples
        if self.stage.own_numbers:
            samples = 0.0  # a pilot that is dropped is no part of the picture
        return Now(samples, self.clock.seconds, 1 / rate if rate else None)

    def keep(self) -> None:
        """A snapshot, if it is time."""
        started = time.monotonic()
        if self.canvas.changed and started >= self._next_snapshot:
            self.save_all()
            taken = time.monotonic() - started
            self._next_snapshot = time.monotonic() + max(SNAPSHOT_SECONDS, SNAPSHOT_SHARE * taken)

    def save_all(self) -> None:
        """A snapshot."""
        self.save()
        self.canvas.flush()

    def save(self) -> None:
        """The state without the sums. It must be on disk before any tile that depends on it."""
        self._unsaved = False
        self.record.seconds = self.clock.seconds
        batches = self.canvas.batches
        kept = Snapshot(self.stage.key, self._tile_size, batches.checked, batches.open_ends, self.record)
        snapshot.save(self.stage.store, kept)

    def _save_first(self) -> None:
        """Before a tile is written, and only then: looks and batches of a short job need no file."""
        if self._unsaved:
            self.save()

    def settle(self) -> int:
        """The picture is there: samples a replicate that make it. Raises RunFailedError, OSError."""
        self.stop()
        end = self.canvas.settle()
        try:
            self.record.counts = self.canvas.film.count(end)
        except ValueError as broken:  # a tile's file, since the last look
            raise RunFailedError("storage", f"the picture cannot be put together: {broken}") from broken
        return end

    def stop(self) -> None:
        """No more time passes."""
        self.clock.stop()
        self.record.seconds = self.clock.seconds

    def _bid(self) -> None:
        """What a second of a device is worth here, after what it has cost so far (jobs.dispatch)."""
        points = self.record.points
        error = points[-1].relmse if points else math.nan
        self.gain = gain_of(error, self._theta, self.record.trace_seconds)

    def _set_up(self, checked: int, open_ends: tuple[int, ...], *, anew: bool = False) -> None:
        """Get to work on the stage: with the batches that were begun, and the tiles that are there. `anew`: it keeps
        nothing of the stage before."""
        stage, task = self.stage, self._task
        batches = Batches(stage.rule, checked, ends=self.record.ends, errors=self.record.errors)
        batches.reopen(open_ends)
        film = Film(
            TileGrid(self._window, self._tile_size),
            self._layout.replicates,
            stage.store,
            stage.key,
            deterministic=self._layout.deterministic,
            memory_limit=task.memory_limit,
            before_write=self._save_first,
        )
        layers = bool(task.scene.film.layers)
        self.canvas = Canvas(film, batches, self.record, stage.levels, layers=layers)
        self._pace = Pace(self.clock.seconds, self.canvas.samples)
        if task.scene.adaptive is not None:
            self._desk.share(stage.levels, stage.allotment, anew=anew)
        self._plan(self.canvas.missing())

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
            layout.replicates, self.stage.strata, layout.deterministic, kernel_hash=kernel_hash()
        )
        record.adaptive = self._task.fixed.adaptive if self._task.fixed else None
        return Snapshot(self.stage.key, self._choose_tile_size(), 0, (), record)

    def _choose_tile_size(self) -> int:
        if self._pixels >= LARGE_WINDOW / 2 and any(device.kind == "gpu" for device in self._engine.usable()):
            return GPU_TILE_SIZE
        return LARGE_TILE_SIZE if self._pixels >= LARGE_WINDOW else TILE_SIZE

    def _advance(self) -> str | None:
        while True:
            self._plan(self.canvas.take_lost(), again=True)
            self._open()
            if self.canvas.batches.current is None:
                return "seconds"  # the time rule leaves no room for another batch
            if not self.canvas.complete:
                return None
            reason = self.canvas.check(self.clock.seconds, self.stage.rule.confidence)
            self._theta = fit_theta(self.record.points).theta
            self._looked()
            if self.stage.pilot and (reason is not None or self._pilot_is_over):
                self._begin_picture()
                continue
            if reason is not None:
                return reason
            self._demand_hope()
            self._foretell()
            self._unsaved = True
            self.canvas.proceed()

    @property
    def _pilot_is_over(self) -> bool:
        limit, seconds = self._task.scene.stop.seconds, self.clock.seconds
        lasted = limit is not None and seconds >= PILOT_SHARE * limit
        return lasted or self.stage.suffices(self.record, seconds)

    def _begin_picture(self) -> None:
        """The pilot has decided: the map first, then the state, then work that depends on them."""
        pilot = self.stage
        end = self.canvas.settle()
        if not pilot.own_numbers:
            self.canvas.flush()
        self.record.seconds = self.clock.seconds
        self.stage = self._stages.decide(self.canvas.film, self.record, end)
        self.record.strata = self.stage.strata
        checked = 0 if pilot.own_numbers else end
        snapshot.save(self.stage.store, Snapshot(self.stage.key, self._tile_size, checked, (), self.record))
        self._unsaved = False
        before = self.canvas.preview
        self._set_up(checked, (), anew=pilot.own_numbers)
        self.canvas.preview = before
        if pilot.own_numbers:
            self._stages.drop_pilot()

    def _demand_hope(self) -> None:
        """A target alone never ends a render of which no sample counts: its error stays unknown."""
        rule, rejected = self.stage.rule, self.canvas.rejected
        if rule.relative_error is None or rule.samples is not None or rule.seconds is not None:
            return
        if self.canvas.taken == 0 and rejected >= MIN_CHECK_SAMPLES * self._pixels:
            what = f"all {rejected} samples were NaN, infinite or negative"
            raise RunFailedError(
                "scene", f"{what}, so that no error can be estimated: are numbers too large?"
            )

    def _open(self) -> None:
        """One more batch where the devices would run dry. There is always one to be checked next: work that waits may
        be of batches which are complete, since that of a discarded tile is planned anew beside what was under way."""
        self._desk.allowed(self._engine.usable())
        while self._desk.idle or self.canvas.batches.current is None:
            if self.canvas.batches.current is not None and (self.stage.pilot or self._ends_here):
                return  # what is rendered past the end could not be kept
            per_index = self._pixels * self._layout.replicates * self.stage.density
            open_samples = self._desk.out_samples / per_index
            rate = self._rate()
            left = self.canvas.batches.seconds_left(self.clock.seconds, open_samples, rate)
            items = self.canvas.open_next(rate, left)
            if items is None:
                return
            self._unsaved = True
            self._plan(items, more_follows=self.canvas.batches.more_follows(rate, left))

    @property
    def _ends_here(self) -> bool:
        """Whether the picture is expected to have its error at the end of the current batch: then the devices wait a moment
        for the look at it, and do not begin a batch that would most likely be dropped."""
        rule, end = self.stage.rule, self.canvas.batches.current
        if rule.relative_error is None or end is None:
            return False
        samples = rule.samples_at(end)
        upper = upper_at(self.record.points, samples)
        return samples >= MIN_CHECK_SAMPLES and upper is not None and upper <= rule.relative_error**2

    def _plan(self, items: list[WorkItem], *, again: bool = False, more_follows: bool = False) -> None:
        """`again`: some of it may be under way; `more_follows`: another batch is sure to come."""
        if items:
            self._desk.add(items, again=again, more_follows=more_follows)
            self._engine.wake()

    def _rate(self) -> float | None:
        """Indices of the axis of samples per second, of the whole picture."""
        rate = self._pace.rate
        return rate / (self._layout.replicates * self.stage.density) if rate else None

    def _foretell(self) -> None:
        record = self.record
        if record.foretold is not None:
            return
        goal = self.stage.goal  # in a pilot too: of the picture
        if goal.relative_error is not None and not fit_theta(record.points).points:
            return
        told = forecast(goal, record.points, self.standing())
        if told is not None:
            record.foretold = Foretold(record.points[-1].samples, told.samples, told.seconds)

    def _remaining_seconds(self) -> float:
        """What the current batch still takes."""
        rate = self._rate()
        return math.inf if rate is None else self.canvas.missing_samples() / rate
