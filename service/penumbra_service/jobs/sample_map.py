"""The map of an adaptive render as its receipt has it: compressed, by blocks of BLOCK where these share a level. Pure."""

from __future__ import annotations

import base64
import zlib
from typing import Final

import numpy as np
from penumbra_kernels.nodes import Tile
from penumbra_scene.receipt import SampleMap

from penumbra_service.film.allocation import BLOCK
from penumbra_service.film.grid import block_starts
from penumbra_service.film.levels import LevelMap, spread

_PIXEL: Final = 1


def sample_map(levels: LevelMap) -> SampleMap | None:
    """None where every pixel takes every index."""
    if levels.levels is None:
        return None
    rows, columns = _starts(levels.window, BLOCK)
    shared = levels.levels[np.ix_(rows, columns)]
    by_block = np.array_equal(spread(shared, levels.window, BLOCK), levels.levels)
    values = np.ascontiguousarray(shared if by_block else levels.levels)
    return SampleMap(
        block=BLOCK if by_block else _PIXEL,
        rows=values.shape[0],
        columns=values.shape[1],
        kept=levels.kept,
        kept_planned=levels.kept_planned,
        shadow_rays=levels.shadow_rays,
        kept_shadow_rays=levels.kept_shadow_rays,
        levels=base64.b64encode(zlib.compress(values.tobytes(), 9)).decode("ascii"),
    )


def levels_of(found: SampleMap, window: Tile) -> LevelMap:
    """Back from sample_map. Raises ValueError where it is broken, or of another window."""
    expected = tuple(len(starts) for starts in _starts(window, found.block))
    if (found.rows, found.columns) != expected:
        raise ValueError(
            f"{found.rows} x {found.columns} blocks, where the picture has {expected[0]} x {expected[1]}"
        )
    values = np.frombuffer(_bytes(found), np.uint8).reshape(expected)
    return LevelMap(
        window,
        spread(values, window, found.block),
        found.kept,
        found.kept_planned,
        found.shadow_rays,
        found.kept_shadow_rays,
    )


def _bytes(found: SampleMap) -> bytes:
    """Never more than the blocks are, whatever the text unpacks to."""
    size = found.rows * found.columns
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(base64.b64decode(found.levels, validate=True), size + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if len(data) != size or not unpacker.eof:
        raise ValueError(f"its levels are not those of {size} blocks")
    return data


def _starts(window: Tile, block: int) -> tuple[list[int], list[int]]:
    """First row and column of each block, counted from the window's corner."""
    edges = ((window.y, window.height), (window.x, window.width))
    rows, columns = (block_starts(*edge, block).tolist() for edge in edges)
    return rows, columns
