"""What a run has rendered so far: the film, the batches that it is made of, and what is known of their error.

One thread. Nothing here knows devices or leases.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterable

from penumbra_kernels.nodes import SumNode, Tile, empty_node

from penumbra_service.film.error import TileSummary, image_error
from penumbra_service.film.film import Film
from penumbra_service.film.levels import LevelMap
from penumbra_service.film.predict import point_of
from penumbra_service.film.preview import Preview
from penumbra_service.film.stop import Reason
from penumbra_service.jobs.batches import Batches
from penumbra_service.jobs.planning import WorkItem
from penumbra_service.jobs.record import RunRecord

log = logging.getLogger(__name__)


class Canvas:
    """Takes nodes in, and says what is missing, what is complete, and whether it is enough."""

    def __init__(
        self, film: Film, batches: Batches, record: RunRecord, levels: LevelMap, *, layers: bool = False
    ) -> None:
        """levels: how pixels share in the axis of samples; layers: nodes have them."""
        self.film = film
        self.levels = levels
        self._layers = layers
        self.batches = batches
        self.record = record
        self.preview = Preview(film.grid.window)
        self.changed = False
        """Whether there are nodes that no snapshot holds."""
        self.taken = self.rejected = 0
        """Samples that counted at the last check, and that did not."""
        self._summaries: dict[Tile, TileSummary] = {}
        self._looking = self._look_seconds = 0.0
        film.restore(batches.barriers)
        self._samples = self._count_samples()
        self._summarize(film.tiles)
        self._show_kept()

    @property
    def window_pixels(self) -> int:
        return self.film.grid.window.width * self.film.grid.window.height

    @property
    def samples(self) -> float:
        """A pixel, on average over the picture, those of open batches included."""
        return self._samples / self.window_pixels

    @property
    def complete(self) -> bool:
        """Whether the batch that is to be checked next is there in every tile."""
        return self.batches.current is not None and len(self._summaries) == len(self.film.tiles)

    def missing(self, tiles: Iterable[Tile] | None = None) -> list[WorkItem]:
        """What is asked for and not there, in order of the batches."""
        wanted = self.film.tiles if tiles is None else list(tiles)
        items = [item for first, end in self.batches.ranges for item in self._items(wanted, first, end)]
        self._summarize(wanted)
        return items

    def open_next(self, rate: float | None, seconds_left: float | None) -> list[WorkItem] | None:
        """Begin one more batch: what it lacks. None where the rule allows none now."""
        opened = self.batches.open_next(rate, seconds_left, self._look_seconds)
        if opened is None:
            return None
        self.film.set_barriers(self.batches.barriers)
        items = self._items(self.film.tiles, *opened)
        self._summarize(self.film.tiles)
        return items

    def take(self, nodes: Iterable[SumNode]) -> None:
        """Add nodes. Raises ValueError for one that was not asked for, OSError where a tile cannot be
        written."""
        touched = []
        for node in nodes:
            if self.film.add(node):
                self._samples += self._taken(node.tile, node.first_sample, node.sample_count)
                self.changed = True
                touched.append(node.tile)
        self._summarize(dict.fromkeys(touched))

    def take_lost(self) -> list[WorkItem]:
        """What must be done again since a tile's file broke while it was not in memory, or since its samples are void."""
        lost = self.film.take_lost()
        for tile, why in lost.items():
            log.warning("%s starts again: %s", tile, why)
            self._summaries.pop(tile, None)
        if lost:
            self._samples = self._count_samples()
        return self.missing(lost)

    def discard(self, tiles: Iterable[Tile] | None) -> None:
        """Forget what these tiles hold, all of them with None: `take_lost` tells what to do again."""
        for tile in self.film.tiles if tiles is None else tiles:
            self.film.discard(tile)

    def look_again(self) -> None:
        """The last check saw wrong samples: it has not taken place."""
        self.batches.look_again()
        if self.record.points:
            self.record.points.pop()
        self.proceed()

    def check(self, seconds: float, confidence: float) -> Reason | None:
        """Look at the picture, whose current batch is complete: why to stop, or None to go on. The caller
        saves the state before it calls `proceed`."""
        end = self.batches.current
        assert end is not None
        summaries = [self._summaries[tile] for tile in self.film.tiles]
        error = image_error(summaries)
        upper = error.upper(confidence) if error.known else math.nan
        samples = self.batches.rule.samples_at(end)
        self.record.points.append(point_of(samples, seconds, error, upper))
        self.taken = sum(summary.taken for summary in summaries)
        self.rejected = sum(summary.rejected for summary in summaries)
        return self.batches.check(seconds, error)

    def proceed(self) -> None:
        """Go on with the next batch after a check."""
        self.film.set_barriers(self.batches.barriers)
        self._look_seconds, self._looking = self._looking, 0.0
        self._summaries.clear()
        self._summarize(self.film.tiles)

    def settle(self) -> int:
        """Samples a replicate that make the picture; what lies beyond is left out."""
        end = self.batches.settle()
        self.film.set_barriers((end,))
        return end

    def missing_samples(self) -> float:
        """Indices of the axis that the current batch lacks, as many as would give all pixels together the samples that
        it lacks."""
        end = self.batches.current
        if end is None:
            return 0.0
        tiles = [tile for tile in self.film.tiles if tile not in self._summaries]
        gaps = [(tile, gap) for tile in tiles for gap in self.film.missing(tile, self.batches.checked, end)]
        taken = sum(self.levels.samples(tile, *gap) for tile, gap in gaps)
        return taken / self.window_pixels / (self.levels.density or 1.0)

    def flush(self) -> None:
        """Write all tiles that have changed. Raises OSError."""
        self.film.flush()
        self.changed = False

    def _items(self, tiles: Iterable[Tile], first: int, end: int) -> list[WorkItem]:
        """What devices must do; ranges of which a tile takes no sample are filled in on the spot."""
        items = []
        for tile in tiles:
            for at, count in self.film.missing(tile, first, end):
                if self.levels.samples(tile, at, count):
                    items.append(WorkItem(tile, at, count))
                else:
                    nothing = empty_node(tile, self.film.replicates, at, count, layers=self._layers)
                    self.changed |= self.film.add(nothing)
        return items

    def _taken(self, tile: Tile, first: int, count: int) -> int:
        return self.film.replicates * self.levels.samples(tile, first, count)

    def _summarize(self, tiles: Iterable[Tile]) -> None:
        """Pool the statistics of those tiles that have become complete up to the current end."""
        end = self.batches.current
        if end is None:
            return
        started = time.perf_counter()
        for tile in tiles:
            if tile not in self._summaries and self.film.complete(tile, end):
                pixels, self._summaries[tile] = self.film.look(tile, end)
                self.preview.put(pixels)
        self._looking += time.perf_counter() - started

    def _show_kept(self) -> None:
        """What a snapshot brought is shown as it stood at the last check, until there is more of it."""
        end = self.batches.checked
        if end:
            for tile in self.film.tiles:
                if tile not in self._summaries and self.film.complete(tile, end):
                    self.preview.put(self.film.pixels(tile, end))

    def _count_samples(self) -> int:
        return sum(
            self._taken(tile, first, count)
            for tile in self.film.tiles
            for first, count in self.film.ranges(tile)
        )
