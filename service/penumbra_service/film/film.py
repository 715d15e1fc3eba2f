"""The film: every tile's sum nodes, of which only the recently used ones are in memory.

One writer: the thread that runs the job. A 4K frame of 8 replicates is some 3 GB; tiles beyond `memory_limit`
are written to their files and read back when a node for them arrives. A snapshot writes the tiles that
changed and nothing else.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from penumbra_kernels.allotment import halves
from penumbra_kernels.nodes import SumNode, Tile, aligned_ranges

from penumbra_service.film.accumulator import TileAccumulator
from penumbra_service.film.counts import PixelCounts, count_pixels
from penumbra_service.film.error import TileSummary, summarize
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.scratch import Empty, Scratch
from penumbra_service.film.statistics import PixelStatistics, pixel_flags, pixel_statistics
from penumbra_service.film.tilefile import TileStore, decode, encode, tile_name

MEMORY_LIMIT: Final = 256 * 1024 * 1024
"""Bytes of tiles that a film keeps in memory."""


class Film:
    """Sums of a window's pixels.

    key names the render (scene, program, sampling): tile files of another one are not read.
    deterministic: the sampler is not random, so that variance is not known.
    """

    def __init__(
        self,
        grid: TileGrid,
        replicates: int,
        store: TileStore,
        key: str,
        *,
        deterministic: bool = False,
        memory_limit: int = MEMORY_LIMIT,
        before_write: Callable[[], None] = lambda: None,
    ) -> None:
        """before_write: called before a tile is written, to write first what a reader of tiles must know."""
        self.grid = grid
        self.replicates = replicates
        self.deterministic = deterministic
        self.barriers: tuple[int, ...] = ()
        self._store = store
        self._key = key
        self._memory_limit = memory_limit
        self._before_write = before_write
        self._tiles = list(grid)
        self._known = frozenset(self._tiles)
        self._resident: OrderedDict[Tile, TileAccumulator] = OrderedDict()
        self._bytes = 0
        self._dirty: set[Tile] = set()
        self._ranges: dict[Tile, list[tuple[int, int]]] = {}
        self._lost: dict[Tile, str] = {}
        """And why."""
        self._scratch = Scratch()

    @property
    def tiles(self) -> list[Tile]:
        """All tiles, row by row."""
        return self._tiles

    @property
    def resident_bytes(self) -> int:
        """Bytes of tiles in memory."""
        return self._bytes

    def restore(self, barriers: tuple[int, ...]) -> None:
        """Read the store's tiles back, as a snapshot or a crash left them. Files that are broken, of another
        render, or reach across a barrier are deleted: their tiles start again."""
        self.barriers = barriers
        names = set(self._store.names())
        for tile in self._tiles:
            name = tile_name(tile)
            if name not in names:
                continue
            accumulator = self._read(tile)
            if accumulator is None:
                self._store.delete(name)
                continue
            self._ranges[tile] = accumulator.ranges
            self._keep(accumulator)

    def add(self, node: SumNode) -> bool:
        """Take a node in; False where its samples were here already. Raises ValueError for one that does not
        fit, OSError where a tile cannot be written."""
        accumulator = self._acquire(node.tile)
        before = accumulator.nbytes
        added = accumulator.add(node)
        if added:
            self._changed(accumulator, before)
        self._evict(node.tile)
        return added

    def set_barriers(self, barriers: tuple[int, ...]) -> None:
        """Samples a replicate at which the render may yet end. Tiles merge across former ones when next
        used."""
        self.barriers = barriers

    def ranges(self, tile: Tile) -> list[tuple[int, int]]:
        """(first sample, count) of the nodes that the tile holds."""
        return self._ranges.get(tile, [])

    def missing(self, tile: Tile, first: int, end: int) -> list[tuple[int, int]]:
        """Aligned ranges (first, count) of samples in [first, end) that the tile lacks."""
        gaps: list[tuple[int, int]] = []
        at = first
        for start, count in self._ranges.get(tile, []):
            if start > at:
                gaps += aligned_ranges(at, min(start, end))
            at = max(at, start + count)
            if at >= end:
                break
        if at < end:
            gaps += aligned_ranges(at, end)
        return gaps

    def complete(self, tile: Tile, end: int) -> bool:
        """Whether the tile has all of its samples [0, end)."""
        return not self.missing(tile, 0, end)

    def pixels(self, tile: Tile, end: int) -> PixelStatistics:
        """Statistics of samples [0, end). Raises ValueError where some are missing."""
        return self._pixels(tile, end)

    def halves(self, end: int) -> tuple[Iterator[PixelStatistics], Iterator[PixelStatistics]]:
        """Statistics of samples [0, end) of all tiles by the first half of the replicates alone, and by the second."""
        first, second = halves(self.replicates)
        return self._of_replicates(end, first), self._of_replicates(end, second)

    def _of_replicates(self, end: int, chosen: slice) -> Iterator[PixelStatistics]:
        for tile in self._tiles:
            part = self.accumulator(tile).fold(end).of_replicates(chosen)
            yield pixel_statistics(tile, part, deterministic=self.deterministic)

    def look(self, tile: Tile, end: int) -> tuple[PixelStatistics, TileSummary]:
        """Statistics of samples [0, end), of alpha the mean alone, which the next look makes void, and the tile's share in the
        picture's error."""
        self._scratch.reset()
        pixels = self._pixels(tile, end, self._scratch.empty, of_alpha=False)
        return pixels, summarize(pixels, self._scratch.empty)

    def count(self, end: int) -> PixelCounts:
        """What became of samples [0, end) of all tiles, and which flags their pixels have."""
        total = PixelCounts()
        for tile in self._tiles:
            pixels = self.pixels(tile, end)
            total.add(count_pixels(pixels, pixel_flags(pixels, deterministic=self.deterministic)))
        return total

    def accumulator(self, tile: Tile) -> TileAccumulator:
        """A tile's nodes, for reading."""
        accumulator = self._acquire(tile)
        self._evict(tile)
        return accumulator

    def discard(self, tile: Tile) -> None:
        """Forget all samples of a tile: it starts again. Raises OSError where its file cannot be deleted."""
        accumulator = self._resident.pop(tile, None)
        if accumulator is not None:
            self._bytes -= accumulator.nbytes
        self._dirty.discard(tile)
        self._store.delete(tile_name(tile))
        if self._ranges.pop(tile, None):
            self._lost[tile] = "some of its samples are wrong"

    def take_lost(self) -> dict[Tile, str]:
        """Tiles whose file turned out gone or broken, or that were discarded, since the last call: they start again.
        Each with the reason."""
        lost, self._lost = self._lost, {}
        return lost

    def flush(self) -> int:
        """Write every tile that changed since it was last written; how many those were. Raises OSError."""
        dirty = [tile for tile in self._tiles if tile in self._dirty]
        for tile in dirty:
            self._write(self._resident[tile])
        return len(dirty)

    def _pixels(
        self, tile: Tile, end: int, empty: Empty = np.empty, *, of_alpha: bool = True
    ) -> PixelStatistics:
        sums = self._acquire(tile).fold(end, empty)
        self._evict(tile)
        return pixel_statistics(tile, sums, deterministic=self.deterministic, empty=empty, of_alpha=of_alpha)

    def _acquire(self, tile: Tile) -> TileAccumulator:
        if tile not in self._known:
            raise ValueError(f"{tile} is no tile of this film")
        accumulator = self._resident.get(tile)
        if accumulator is None:
            accumulator = self._read(tile) if tile in self._ranges else None
            if accumulator is None:
                if self._ranges.pop(tile, None):
                    gone = self._store.read(tile_name(tile)) is None
                    self._lost[tile] = "its file is gone" if gone else "its file is broken"
                accumulator = TileAccumulator(tile, self.replicates)
            self._keep(accumulator)
        self._resident.move_to_end(tile)
        if accumulator.barriers != self.barriers:
            before, ranges = accumulator.nbytes, accumulator.ranges
            accumulator.set_barriers(self.barriers)
            if accumulator.ranges != ranges:
                self._changed(accumulator, before)
        return accumulator

    def _read(self, tile: Tile) -> TileAccumulator | None:
        data = self._store.read(tile_name(tile))
        if data is None:
            return None
        accumulator = decode(data, tile, self.replicates, self._key)
        if accumulator is None or any(accumulator.crosses(barrier) for barrier in self.barriers):
            return None
        return accumulator

    def _keep(self, accumulator: TileAccumulator) -> None:
        self._resident[accumulator.tile] = accumulator
        self._bytes += accumulator.nbytes
        self._evict(accumulator.tile)

    def _changed(self, accumulator: TileAccumulator, bytes_before: int) -> None:
        self._ranges[accumulator.tile] = accumulator.ranges
        self._dirty.add(accumulator.tile)
        self._bytes += accumulator.nbytes - bytes_before

    def _evict(self, keep: Tile) -> None:
        while self._bytes > self._memory_limit and len(self._resident) > 1:
            tile = next(t for t in self._resident if t != keep)
            accumulator = self._resident[tile]
            if tile in self._dirty:
                self._write(accumulator)
            del self._resident[tile]
            self._bytes -= accumulator.nbytes

    def _write(self, accumulator: TileAccumulator) -> None:
        self._before_write()
        self._store.write(tile_name(accumulator.tile), encode(accumulator, self._key))
        self._dirty.discard(accumulator.tile)
