"""A pilot: some blocks of a picture rendered ahead of everything else, to tell what the whole will take.

It asks the engine for leases like any job, with a priority above all of them, so that it waits for two leases of a
busy device at most. Nothing that it renders goes into a picture: its samples have a seed of their own.
"""

from __future__ import annotations

import math
import queue
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from penumbra_kernels.allotment import AS_GIVEN, even
from penumbra_kernels.nodes import Tile
from penumbra_scene.check import scene_hash
from penumbra_scene.scene import Scene

from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.launch_cost import Rounds, Work
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
from penumbra_service.engine.task import RunFailedError
from penumbra_service.film.accumulator import TileAccumulator
from penumbra_service.film.counts import count_untrusted
from penumbra_service.film.error import TileSummary, summarize
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.pilot import (
    affordable,
    blocks_of,
    choose_blocks,
    most_blocks,
    most_samples,
    pilot_point,
    round_ends,
)
from penumbra_service.film.predict import fit_theta
from penumbra_service.film.quoted_saving import QuotedSaving
from penumbra_service.film.replicates import choose_layout
from penumbra_service.film.statistics import pixel_flags, pixel_statistics
from penumbra_service.images.limits import DEFAULTS, DecodeLimits
from penumbra_service.jobs.pilot import PilotResult
from penumbra_service.jobs.planning import WorkItem
from penumbra_service.jobs.record import DeviceUse

PRIORITY: Final = 1000
"""Above that of every job (at most 100)."""
PILOT_SECONDS: Final = 2.0
"""What the rounds may take by the clock, with the scene loaded."""
OVERTIME: Final = 1.25
"""A round is begun only if it should be over within so many times that."""
LEAST_BLOCKS: Final = 12
"""Rounds of fewer are not worth their time."""
GO_ON_SECONDS: Final = 1.0
"""A pilot that is through sooner goes on with more samples: a small picture's is over in a tenth of a second, which tells
nothing of the speed at which a job goes on, and little of a low error."""
PROBE_BLOCKS: Final = 16
"""Are rendered first, to learn how many can be afforded."""
PROBE_SECONDS: Final = 0.05
"""That rendering them should take at least."""
PACE_SECONDS: Final = 0.4
"""Of whole tiles on GPUs, which blocks do not fill."""
PACE_TILE: Final = 256
PATIENCE_SECONDS: Final = 300.0
"""Until the devices must have answered: one may have to compile, or to finish what it is at."""
SEED_MASK: Final = 0x7069_6C6F_7400_0001
"""Turns a scene's seed into the pilot's."""


@dataclass(frozen=True)
class PilotTask:
    """What to find out about."""

    scene: Scene
    folder: Path
    """For the scene's own file; the caller removes it."""
    assets_folder: Path | None = None
    scene_folder: Path | None = None
    time: float = 0.0
    decode: DecodeLimits = DEFAULTS


class PilotRunner:
    """Runs one PilotTask on an engine, once. Implements protocol.LeaseSource.

    Raises film.replicates.UnknownErrorTargetError where an error is asked for that cannot be known.
    """

    def __init__(self, engine: Engine, task: PilotTask, name: str = "quote") -> None:
        self._engine = engine
        self._task = task
        self._name = name
        self._layout = choose_layout(task.scene.sampler, task.scene.stop)
        window = task.scene.film.window
        self._window = Tile(window.x, window.y, window.width, window.height)
        self._pixels = window.width * window.height
        self._blocks = blocks_of(self._window)
        self._seed = task.scene.sampler.seed ^ SEED_MASK
        self._spec = self._make_spec()
        self._inbox: queue.SimpleQueue[tuple[DeviceDescription, ToJob]] = queue.SimpleQueue()
        self._desk = LeaseDesk(name, self._spec, hungry=lambda: None)
        self._tiles: dict[Tile, TileAccumulator] = {}
        self._summaries: dict[int, dict[Tile, TileSummary]] = {}
        """By the end of the round."""
        self._saving = QuotedSaving(task.scene, self._layout.replicates)
        if self._saving.compared != AS_GIVEN:
            rays = self._saving.compared
            self._desk.share(LevelMap(self._window), lambda tile: even(tile, shadow_rays=rays), anew=True)
        self._untrusted = 0
        """Pixels of the newest round whose error bar is not to be trusted."""
        self._paces: dict[str, Rounds] = {}
        """Of each device."""
        self._pending = 0
        """Samples that the round lacks."""
        self._keep = self._timing = True
        self._began: float | None = None
        self._result = PilotResult(self._layout, blocks_in_picture=len(self._blocks))

    @property
    def job(self) -> str:
        return self._name

    @property
    def priority(self) -> int:
        return PRIORITY

    @property
    def scene(self) -> str:
        return self._spec.key

    @property
    def gain(self) -> float:
        """Of no account: nothing else has its priority but other pilots."""
        return 0.0

    def next_lease(self, device: DeviceDescription) -> Lease | None:
        """Work for a device (engine's thread)."""
        return self._desk.next_lease(device)

    def deliver(self, device: DeviceDescription, event: ToJob) -> None:
        """News for the pilot (engine's thread)."""
        self._inbox.put((device, event))

    def run(self) -> PilotResult:
        """Blocks until the rounds are done. Raises RunFailedError, OSError."""
        self._task.folder.mkdir(parents=True, exist_ok=True)
        Path(self._spec.scene_path).write_bytes(self._scene().model_dump_json().encode())
        self._until = time.monotonic() + PATIENCE_SECONDS
        self._engine.attach(self)
        try:
            self._rounds()
        finally:
            self._desk.close()
            self._engine.detach(self)
        return self._result

    def _scene(self) -> Scene:
        scene = self._task.scene
        return scene.model_copy(update={"sampler": scene.sampler.model_copy(update={"seed": self._seed})})

    def _make_spec(self) -> RenderSpec:
        task = self._task
        return RenderSpec(
            scene_path=str((task.folder / "scene.json").resolve()),
            scene_hash=scene_hash(self._scene()),
            assets_folder=None if task.assets_folder is None else str(task.assets_folder.resolve()),
            scene_folder=None if task.scene_folder is None else str(task.scene_folder.resolve()),
            time=task.time,
            replicates=self._layout.replicates,
            strata=0,
            program="specialised",  # the one whose rate the job will mostly have
            decode=task.decode,
        )

    def _rounds(self) -> None:
        ends = round_ends(self._layout.replicates)
        self._probe(ends)
        if any(device.kind == "gpu" for device in self._engine.usable()):
            self._pace()
        most = min(len(self._blocks), most_blocks())
        left = PILOT_SECONDS - self._elapsed()
        count, rounds = affordable(self._rate(), left, self._layout.replicates, ends, most)
        chosen = choose_blocks(self._blocks, count, self._seed)
        if self._timing:
            self._paces.clear()  # the probe's caches were cold
        done = 0
        for end in ends[:rounds]:
            chosen = self._within_time(chosen, end - done) if done else chosen
            if not chosen:
                break
            self._round(chosen, done, end)
            done = end
        if chosen and rounds == len(ends):
            self._go_on(chosen, done)
        self._conclude()

    def _probe(self, ends: Sequence[int]) -> None:
        """Learn how many blocks can be afforded. Caches are cold at first, and few samples are mostly launching: more are taken
        until they say something."""
        tiles, done = choose_blocks(self._blocks, PROBE_BLOCKS, self._seed), 0
        for end in ends:
            self._paces.clear()
            began = time.monotonic()
            self._render(tiles, done, end, keep=False)
            if time.monotonic() - began > PROBE_SECONDS:
                break
            done = end

    def _round(self, tiles: list[Tile], done: int, end: int) -> None:
        if self._timing:
            self._begin_round()
        self._render(tiles, done, end)
        self._look(tiles, end)

    def _go_on(self, tiles: list[Tile], done: int) -> None:
        """Rounds as long as all before, while there is time."""
        while done < most_samples(self._layout.replicates):
            left = GO_ON_SECONDS - self._elapsed()
            if self._samples_of(tiles, done) > left * self._rate():
                break
            self._round(tiles, done, 2 * done)
            done *= 2

    def _begin_round(self) -> None:
        for pace in self._paces.values():
            pace.begin_round()

    def _within_time(self, tiles: list[Tile], count: int) -> list[Tile]:
        """Those that the next round can still take: half of them where time is short, again and again."""
        left = OVERTIME * PILOT_SECONDS - self._elapsed()
        while tiles and self._samples_of(tiles, count) > left * self._rate():
            tiles = tiles[::2] if len(tiles) >= 2 * LEAST_BLOCKS else []
        return tiles

    def _pace(self) -> None:
        """Whole tiles, for devices that blocks leave idle: their rate is that of a job."""
        self._paces.clear()
        tiles = list(TileGrid(self._window, PACE_TILE))
        at_once = len(self._engine.usable())
        until = time.monotonic() + PACE_SECONDS
        for first in range(0, len(tiles), at_once):
            self._render(tiles[first : first + at_once], 0, 1, keep=False)
            if time.monotonic() > until:
                break
        self._timing = False

    def _samples_of(self, tiles: Sequence[Tile], count: int) -> int:
        return sum(tile.width * tile.height for tile in tiles) * self._layout.replicates * count

    def _render(self, tiles: Sequence[Tile], first: int, end: int, *, keep: bool = True) -> None:
        """Samples [first, end) of each replicate, all devices together; blocks until they are there."""
        tiles = list(dict.fromkeys(tiles))
        self._pending = self._samples_of(tiles, end - first)
        self._keep = keep
        self._desk.allowed(self._engine.usable())
        self._desk.add(WorkItem(tile, first, end - first) for tile in tiles)
        self._engine.wake()
        while self._pending > 0:
            try:
                device, event = self._inbox.get(timeout=max(self._until - time.monotonic(), 0.0))
            except queue.Empty:
                raise RunFailedError("device", f"no device answered in {PATIENCE_SECONDS:g} s") from None
            self._take(device, event)

    def _take(self, device: DeviceDescription, event: ToJob) -> None:
        match event:
            case LeaseResult():
                self._take_result(device, event)
            case SceneLoaded():
                self._take_scene(event)
            case LeaseLost(_, _, True, reason):
                raise RunFailedError("crash", reason)
            case LeaseLost(lease, _, _, _):
                self._desk.give_back(lease)
                self._engine.wake()
            case LeaseFailure():
                self._take_failure(device, event)
            case NoDevice(reason):
                raise RunFailedError("device", reason)

    def _take_result(self, device: DeviceDescription, result: LeaseResult) -> None:
        if not self._desk.answered(result, device):
            return
        self._start_clock()
        samples = sum(node.sums.size * node.sample_count for node in result.nodes)
        if self._timing:
            pace = self._paces.setdefault(device.id, Rounds())
            pace.leases.append(Work(len(result.nodes), samples, max(result.seconds, 1e-9)))
        self._pending -= samples
        use = self._result.devices.setdefault(
            device.id, DeviceUse(device.id, device.name, device.platform, device.driver, device.bit_class)
        )
        use.leases += 1
        use.seconds += result.seconds
        for node in result.nodes:
            if self._keep:
                tile = self._tiles.setdefault(node.tile, TileAccumulator(node.tile, self._layout.replicates))
                tile.add(node)

    def _take_scene(self, loaded: SceneLoaded) -> None:
        self._start_clock()
        result = self._result
        result.build_seconds += loaded.build_seconds
        result.compile_seconds += loaded.compile_seconds
        result.build_warm &= loaded.build_warm
        result.compile_warm &= loaded.compile_warm

    def _take_failure(self, device: DeviceDescription, failure: LeaseFailure) -> None:
        if failure.kind in ("scene", "device", "storage"):
            raise RunFailedError(failure.kind, failure.message)
        self._desk.give_back(failure.lease)
        self._desk.exclude(device.id)
        if not self._desk.allowed(self._engine.usable()):
            raise RunFailedError("build" if failure.kind == "build" else "crash", failure.message)
        self._engine.wake()

    def _start_clock(self) -> None:
        if self._began is None:
            self._began = time.monotonic()

    def _elapsed(self) -> float:
        return 0.0 if self._began is None else time.monotonic() - self._began

    def _rate(self) -> float:
        """Samples a second of all devices together."""
        return sum(pace.samples_per_second for pace in self._paces.values())

    def _look(self, tiles: Sequence[Tile], end: int) -> None:
        """Pool what a round has brought."""
        deterministic = self._layout.deterministic
        round_: dict[Tile, TileSummary] = {}
        untrusted = 0
        for tile in tiles:
            sums = self._tiles[tile].fold(end)
            pixels = pixel_statistics(tile, sums, deterministic=deterministic)
            round_[tile] = summarize(pixels)
            untrusted += count_untrusted(pixel_flags(pixels, deterministic=deterministic))
            self._saving.look(end, pixels, sums)
        self._summaries[end] = round_
        self._untrusted = untrusted

    def _conclude(self) -> None:
        """Points of all rounds over the blocks that were in the last."""
        last = list(self._summaries.values())[-1]
        result, stop = self._result, self._task.scene.stop
        result.blocks = len(last)
        result.pixels = sum(s.all_pixels for s in last.values())
        result.flagged_share = self._untrusted / result.pixels
        taken, rejected = sum(s.taken for s in last.values()), sum(s.rejected for s in last.values())
        result.rejected_share = rejected / max(taken + rejected, 1)
        result.seconds = self._elapsed()
        result.seconds_per_sample = self._pixels / sum(1 / pace.cost.sample for pace in self._paces.values())
        result.rate_deviation = self._rate_deviation()
        for end, round_ in self._summaries.items():
            samples = end * self._layout.replicates
            seconds = samples * result.seconds_per_sample
            summaries = [round_[tile] for tile in last]
            result.points.append(pilot_point(summaries, samples, seconds, len(self._blocks), stop.confidence))
        result.saving = self._saving.saving(fit_theta(result.points).theta)

    def _rate_deviation(self) -> float:
        """From the spread of seconds a sample over leases, which are of different blocks, and from
        what rounds deviate by from their cost."""
        costs = [
            pace.cost.seconds_per_sample(lease) for pace in self._paces.values() for lease in pace.leases
        ]
        if len(costs) < 2:
            return 0.0
        over_leases = statistics.stdev(costs) / statistics.fmean(costs) / math.sqrt(len(costs))
        return math.hypot(over_leases, *(pace.unsteadiness for pace in self._paces.values()))
