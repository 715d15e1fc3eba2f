"""The map of an adaptive render: a level for each pixel of the window, which says how many samples it takes.

A job counts its samples on one axis of indices a replicate (penumbra_kernels.allotment); a pixel of level j takes one in
2^j of them. Everything that plans, counts or forecasts in samples a pixel asks this map for the mean over the picture.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.allotment import AS_GIVEN, LEVEL_NONE, Allotment, ShadowRays, own_samples
from penumbra_kernels.nodes import Tile

from penumbra_service.film.grid import block_lengths

NAME: Final = "levels.map"
MAGIC: Final = b"PENULEV3"


class LevelMap:
    """Levels of a window's pixels; those of blocks, or of single pixels, as was decided. Immutable."""

    def __init__(
        self,
        window: Tile,
        levels: NDArray[np.uint8] | None = None,
        kept: int = 0,
        kept_planned: int = 0,
        shadow_rays: int = 0,
        kept_shadow_rays: ShadowRays = AS_GIVEN,
    ) -> None:
        """levels: (window height, window width), None: every pixel takes every index. kept: indices of each replicate
        that all pixels take whatever their level, 0 or a power of two. kept_planned: for how many their strata were
        made; a pilot that the clock ended early took fewer, and 0 is one whose end was not known. shadow_rays: that hits take,
        0: as many as the scene has; kept_shadow_rays: that those of the kept ones took."""
        if levels is not None and levels.shape != (window.height, window.width):
            raise ValueError(
                f"levels of shape {levels.shape} for a window of {window.height} x {window.width}"
            )
        self.window = window
        self.levels = levels
        self.kept = kept
        self.kept_planned = kept_planned
        self.shadow_rays = shadow_rays
        self.kept_shadow_rays = kept_shadow_rays

    @cached_property
    def histogram(self) -> dict[int, int]:
        """Pixels by level."""
        return _histogram(self.levels) if self.levels is not None else {0: self._pixels}

    @cached_property
    def density(self) -> float:
        """Samples of a pixel for each index beyond the kept ones, on average over the picture."""
        shares = sum(n * 2.0**-level for level, n in self.histogram.items() if level != LEVEL_NONE)
        return shares / self._pixels

    def mean(self, end: int) -> float:
        """Samples a replicate that a pixel takes of the indices below `end`, on average over the picture."""
        return _total(self.histogram, self.kept, end) / self._pixels

    def end_for(self, samples: int) -> int:
        """The end, 1 at least, at which the mean is nearest to `samples` a replicate; where no pixel takes more than the
        kept ones, their number. Ends at which all levels take a sample at once raise the mean by one."""
        if self.levels is None or samples <= self.kept:
            return samples
        if self.density == 0:
            return self.kept
        high = self.end_reaching(samples)
        low = high - 1
        return low if low > self.kept and samples - self.mean(low) < self.mean(high) - samples else high

    def end_reaching(self, samples: int) -> int:
        """The first end at which the mean is at least `samples` a replicate, more than the kept ones; some pixel must take
        more than these."""
        low, high = self.kept, self.kept + int((samples - self.kept) / self.density) + 1
        while self.mean(high) < samples:  # behind the kept ones each level waits for its first index
            low, high = high, 2 * high
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.mean(middle) >= samples else (middle, high)
        return high

    def samples(self, tile: Tile, first: int, count: int) -> int:
        """What all pixels of a tile together take of [first, first + count), a replicate."""
        if self.levels is None:
            return tile.width * tile.height * count
        histogram = self._tile_histogram(tile)
        return _total(histogram, self.kept, first + count) - _total(histogram, self.kept, first)

    def allotment(self, tile: Tile, planned: int) -> Allotment:
        """What a device must know of a tile; planned: indices a replicate, 0 where that is not known."""
        return Allotment(
            self._of(tile),
            self.kept,
            planned,
            kept_planned=self.kept_planned,
            shadow_rays=(self.shadow_rays, self.shadow_rays),
            kept_shadow_rays=self.kept_shadow_rays,
        )

    def _of(self, tile: Tile) -> NDArray[np.uint8]:
        if self.levels is None:
            return np.zeros((tile.height, tile.width), np.uint8)
        y, x = tile.y - self.window.y, tile.x - self.window.x
        return np.ascontiguousarray(self.levels[y : y + tile.height, x : x + tile.width])

    @cached_property
    def _tiles(self) -> dict[Tile, dict[int, int]]:
        return {}

    def _tile_histogram(self, tile: Tile) -> dict[int, int]:
        if tile not in self._tiles:
            self._tiles[tile] = _histogram(self._of(tile))
        return self._tiles[tile]

    @property
    def _pixels(self) -> int:
        return self.window.width * self.window.height


def spread(values: NDArray[np.uint8], window: Tile, block: int) -> NDArray[np.uint8]:
    """(height, width) of a window, from a value for each block of this side, aligned to the full frame."""
    rows = block_lengths(window.y, window.height, block)
    columns = block_lengths(window.x, window.width, block)
    result: NDArray[np.uint8] = np.repeat(np.repeat(values, rows, axis=0), columns, axis=1)
    return result


def _histogram(levels: NDArray[np.uint8]) -> dict[int, int]:
    counts = np.bincount(levels.ravel(), minlength=1)
    return {int(level): int(counts[level]) for level in np.flatnonzero(counts)}


def _total(histogram: dict[int, int], kept: int, end: int) -> int:
    return sum(n * own_samples(end, level, kept) for level, n in histogram.items())


def encode(levels: LevelMap, key: str) -> bytes:
    """A map that was decided, as bytes; `key` names the render that it belongs to."""
    assert levels.levels is not None
    w = levels.window
    header = {
        "key": key,
        "window": [w.x, w.y, w.width, w.height],
        "kept": levels.kept,
        "kept_planned": levels.kept_planned,
        "shadow_rays": levels.shadow_rays,
        "kept_shadow_rays": levels.kept_shadow_rays,
    }
    text = json.dumps(header).encode()
    body = MAGIC + struct.pack("<I", len(text)) + text + zlib.compress(levels.levels.tobytes())
    return body + hashlib.sha256(body).digest()


def decode(data: bytes | None, window: Tile, key: str) -> LevelMap | None:
    """None where the bytes are not there, broken, or of another render."""
    size = hashlib.sha256().digest_size
    if data is None or data[: len(MAGIC)] != MAGIC or hashlib.sha256(data[:-size]).digest() != data[-size:]:
        return None
    (length,) = struct.unpack_from("<I", data, len(MAGIC))
    at = len(MAGIC) + 4
    header: dict[str, Any] = json.loads(data[at : at + length])
    if header["key"] != key or header["window"] != [window.x, window.y, window.width, window.height]:
        return None
    values = np.frombuffer(zlib.decompress(data[at + length : -size]), np.uint8)
    shaped = values.reshape(window.height, window.width)
    first, second = header["kept_shadow_rays"]
    return LevelMap(
        window, shaped, header["kept"], header["kept_planned"], header["shadow_rays"], (first, second)
    )
