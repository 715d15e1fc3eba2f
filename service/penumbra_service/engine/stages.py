"""The stages of a run: of an adaptive one a pilot, which decides how many samples each pixel takes, then the picture; of
any other the picture alone.

The pilot of a certified render has random numbers and tiles of its own, which are dropped once it has decided (Kirk and
Arvo 1991, "Unbiased Sampling Techniques for Image Synthesis"); the others' is the picture's beginning. The map that it
decides is written down before anything that depends on it, and a restart reads it back.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.allotment import AS_GIVEN, Allotment, ShadowRays, even
from penumbra_kernels.nodes import Tile
from penumbra_scene.adaptive import Adaptive
from penumbra_scene.limits import MAX_PILOT_SAMPLES
from penumbra_scene.scene import Scene

from penumbra_service.engine import snapshot
from penumbra_service.engine.snapshot import Snapshot
from penumbra_service.engine.task import FixedPlan
from penumbra_service.film import levels
from penumbra_service.film.allocation import (
    PILOT_PART,
    contrast_levels,
    error_levels,
    pilot_of,
    pilot_suffices,
    spreading_pays,
    theta_of,
)
from penumbra_service.film.film import Film
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.replicates import Layout, pilot_samples
from penumbra_service.film.shadow_rays import compared, comparison_of
from penumbra_service.film.stop import StopRule
from penumbra_service.film.tilefile import FolderTileStore
from penumbra_service.jobs.record import AdaptiveUse, RunRecord

PILOT_SHARE: Final = 0.1
"""Of the seconds that a job may take: a pilot that has reached it ends with what it has."""
PILOT_BUDGET: Final = 0.25
"""Of a job's samples: what the least pilot takes at most where nothing else is asked for."""


NOTHING_TO_SPREAD: Final = (
    "the pilot tells that spreading samples by error saves nothing here: all pixels take equally many"
)


@dataclass(frozen=True)
class Stage:
    """What a run works on."""

    rule: StopRule
    store: FolderTileStore
    key: str
    strata: int
    """Indices of each replicate that are planned; 0: unknown."""
    levels: LevelMap
    goal: StopRule
    """What the job is to come to: the rule of the picture, or in a pilot that of a picture without a map."""
    pilot: bool = False
    least: int = 0
    """Samples a pixel that a pilot always has; more, up to the rule's, while film.allocation asks for them."""
    own_numbers: bool = False
    """A pilot whose samples the picture does not keep."""
    compared: ShadowRays = AS_GIVEN
    """What hits in the halves of a pilot's replicates take."""

    def suffices(self, record: RunRecord, seconds: float) -> bool:
        """Whether a pilot that was just looked at may decide, after `seconds` of tracing."""
        samples = record.points[-1].samples
        return samples >= self.least and pilot_suffices(samples, seconds, self.goal, record.points)

    @property
    def density(self) -> float:
        """Samples of a pixel for each index of the axis, on average over the picture."""
        return self.levels.density or 1.0

    def allotment(self, tile: Tile) -> Allotment:
        """What a device must know of a tile."""
        if self.pilot:
            return even(tile, self.strata, pilot=self.own_numbers, shadow_rays=self.compared)
        return self.levels.allotment(tile, self.strata)


class Stages:
    """The stages of one run, in its folder. `layout`: of the picture."""

    def __init__(
        self,
        scene: Scene,
        layout: Layout,
        window: Tile,
        folder: Path,
        key: str,
        fixed: FixedPlan | None = None,
    ) -> None:
        """`fixed`: what the picture takes is known beforehand, so that there is no pilot."""
        self.adaptive = None if fixed else scene.adaptive
        self._fixed = fixed
        self._stop = scene.stop
        self._compared = compared(scene, layout.replicates)
        self._layout = layout
        self._window = window
        self._key = key
        self._tiles = FolderTileStore(folder / "tiles")
        self._pilot_tiles = FolderTileStore(folder / "pilot")

    def resume(self) -> tuple[Stage, Snapshot | None]:
        """Where an earlier run has left off; no snapshot: nothing that could be used is there."""
        if self.adaptive is None:
            known = self._fixed.levels if self._fixed else None
            stage = self._picture(known or LevelMap(self._window))
            return stage, snapshot.load(stage.store, stage.key)
        kept = snapshot.load(self._tiles, self._key)
        if kept is not None and kept.record.adaptive is not None:
            decided = levels.decode(self._tiles.read(levels.NAME), self._window, self._key)
            if decided is not None:
                return self._picture(decided), kept
        stage = self._pilot(self.adaptive)
        kept = snapshot.load(stage.store, stage.key)
        return stage, None if kept is not None and kept.record.adaptive is not None else kept

    def clear(self) -> None:
        """Delete all that earlier runs have left."""
        for store in (self._tiles, self._pilot_tiles):
            _empty(store)

    def decide(self, film: Film, record: RunRecord, end: int) -> Stage:
        """The picture's stage, from a pilot whose film has `end` samples a replicate. Raises OSError."""
        assert self.adaptive is not None
        pilot = self._pilot(self.adaptive)
        kept = 0 if pilot.own_numbers else end
        theta, values = self._levels(self.adaptive, film, record, end)
        rays = self._shadow_rays(pilot.compared, film, end)
        of_kept = (pilot.strata, rays, pilot.compared) if kept else (0, rays)
        decided = LevelMap(self._window, values, kept, *of_kept)
        self._tiles.write(levels.NAME, levels.encode(decided, self._key))
        record.adaptive = AdaptiveUse(
            "contrast" if self.adaptive.strategy == "contrast" else "error",
            "fast" if self.adaptive.biased else "certified",
            kept,
            end * self._layout.replicates,
            record.seconds,
            theta,
            {str(level): count for level, count in decided.histogram.items()},
            rays,
        )
        if not kept:
            record.points.clear()
            record.ends.clear()
            record.counts = None
        return self._picture(decided)

    def drop_pilot(self) -> None:
        """What a certified render's pilot has left."""
        _empty(self._pilot_tiles)

    def _levels(
        self, adaptive: Adaptive, film: Film, record: RunRecord, end: int
    ) -> tuple[float | None, NDArray[np.uint8]]:
        if adaptive.strategy == "contrast":
            return None, contrast_levels(_picture_of(film, end), adaptive.contrast)
        errors = [point.mse for point in record.points if 2 * point.samples >= record.points[-1].samples]
        theta = theta_of(errors[0], errors[-1]) if len(errors) > 1 else theta_of(0.0, 0.0)
        if film.replicates >= 4 and not spreading_pays(self._window, film.halves(end), theta):
            record.warnings.append(NOTHING_TO_SPREAD)
            return theta, np.zeros((self._window.height, self._window.width), np.uint8)
        pilot = pilot_of(self._window, (film.pixels(tile, end) for tile in film.tiles))
        kept = end if adaptive.biased else 0
        return theta, error_levels(self._window, pilot, theta, self._layout.samples_per_replicate, kept)

    def _shadow_rays(self, tried: ShadowRays, film: Film, end: int) -> int:
        """That the picture's hits take; 0: as many as the scene has, nothing was compared."""
        if tried == AS_GIVEN:
            return 0
        one, whole = (pilot_of(self._window, half) for half in film.halves(end))
        return comparison_of(one, whole, tried[1]).choice

    def _pilot(self, adaptive: Adaptive) -> Stage:
        least, own = self._least_pilot(adaptive), not adaptive.biased
        grows = adaptive.pilot_samples is None and adaptive.strategy == "error"
        most = max(least, self._most_pilot()) if grows else least
        known = not grows or self._layout.strata > 0
        return Stage(
            StopRule(self._layout.replicates, most, deciding=True),
            self._pilot_tiles if own else self._tiles,
            f"{self._key}-pilot" if own else self._key,
            most if known else 0,
            LevelMap(self._window),
            self._picture(LevelMap(self._window)).rule,
            pilot=True,
            least=least * self._layout.replicates,
            own_numbers=own,
            compared=self._compared,
        )

    def _least_pilot(self, adaptive: Adaptive) -> int:
        """Samples a replicate: a power of two."""
        replicates, most = self._layout.replicates, self._layout.samples_per_replicate
        wanted = -(-adaptive.pilot // replicates)
        if most is not None:
            # A picture cannot begin with more samples than it is to have.
            limit = most if adaptive.pilot_samples is not None else int(PILOT_BUDGET * most)
            wanted = (
                min(wanted, max(limit, 1)) if adaptive.biased or adaptive.pilot_samples is None else wanted
            )
        rounded = pilot_samples(wanted)
        return rounded // 2 if adaptive.biased and most is not None and rounded > most else rounded

    def _most_pilot(self) -> int:
        """Samples a replicate: a power of two."""
        most = MAX_PILOT_SAMPLES // self._layout.replicates
        if self._layout.samples_per_replicate is not None:
            most = min(most, int(PILOT_PART * self._layout.samples_per_replicate))
        return 1 << max(most, 1).bit_length() - 1

    def _picture(self, decided: LevelMap) -> Stage:
        stop, layout = self._stop, self._layout
        samples, strata = layout.samples_per_replicate, layout.strata
        if decided.levels is not None:
            samples = decided.kept if decided.density == 0 else samples and decided.end_for(samples)
            strata = decided.end_for(strata) if strata else 0
        rule = StopRule(
            layout.replicates, samples, stop.seconds, stop.relative_error, stop.confidence, levels=decided
        )
        if self._fixed is not None:
            rule = StopRule(layout.replicates, self._fixed.end, confidence=stop.confidence, levels=decided)
        return Stage(rule, self._tiles, self._key, strata, decided, rule)


def _empty(store: FolderTileStore) -> None:
    for name in store.names():
        store.delete(name)


def _picture_of(film: Film, end: int) -> NDArray[Any]:
    """R, G and B of all pixels, (height, width, 3)."""
    window = film.grid.window
    rgb = np.zeros((window.height, window.width, 3), np.float32)
    for tile in film.tiles:
        y, x = tile.y - window.y, tile.x - window.x
        rgb[y : y + tile.height, x : x + tile.width] = film.pixels(tile, end).mean[..., :3]
    return rgb
