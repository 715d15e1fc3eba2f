"""Tiles as files that describe themselves: which render they belong to, which samples they hold, and a
checksum.

Layout: 8 bytes of magic, a little-endian uint32 header length, a JSON header, the nodes' arrays in order
(sums, then layers), a CRC-32 of all before it. Whatever is wrong with a file, its tile starts again; nothing
is ever fatal.
"""

from __future__ import annotations

import contextlib
import json
import os
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.layout import LAYERS
from penumbra_kernels.nodes import FLOAT32_SAMPLES, SumNode, Tile
from penumbra_kernels.sums import Sums, empty_sums

from penumbra_service.film.accumulator import TileAccumulator

MAGIC: Final = b"PENUTIL2"


class TileStore(Protocol):
    """Where tile files live. `write` must be atomic: a reader sees the old bytes or the new ones."""

    def read(self, name: str) -> bytes | None: ...

    def write(self, name: str, data: bytes) -> None: ...

    def names(self) -> list[str]: ...

    def delete(self, name: str) -> None: ...


class FolderTileStore:
    """A local folder, made when it is first written to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def read(self, name: str) -> bytes | None:
        """The bytes, or None where there are none to be had."""
        try:
            return (self.folder / name).read_bytes()
        except OSError:
            return None

    def write(self, name: str, data: bytes) -> None:
        """Through a temporary file that is renamed. Raises OSError, for instance on a full disk."""
        self.folder.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=self.folder, prefix=".", suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            Path(temporary).replace(self.folder / name)
        except OSError:
            with contextlib.suppress(OSError):
                Path(temporary).unlink()
            raise

    def names(self) -> list[str]:
        """All files, sorted; temporary ones left over from a crash not among them."""
        if not self.folder.is_dir():
            return []
        return sorted(path.name for path in self.folder.iterdir() if not path.name.startswith("."))

    def delete(self, name: str) -> None:
        """Remove a file if it is there."""
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()


class MemoryTileStore:
    """A dictionary: for renders that need no restart and are known to be small."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}

    def read(self, name: str) -> bytes | None:
        return self.files.get(name)

    def write(self, name: str, data: bytes) -> None:
        self.files[name] = data

    def names(self) -> list[str]:
        return sorted(self.files)

    def delete(self, name: str) -> None:
        self.files.pop(name, None)


def tile_name(tile: Tile) -> str:
    """The file name of a tile."""
    return f"{tile.x}-{tile.y}.tile"


def encode(accumulator: TileAccumulator, key: str) -> bytes:
    """An accumulator's nodes as bytes. `key` says which render they belong to."""
    tile = accumulator.tile
    header = {
        "key": key,
        "tile": [tile.x, tile.y, tile.width, tile.height],
        "replicates": accumulator.replicates,
        "nodes": [[n.first_sample, n.sample_count, n.layers is not None] for n in accumulator.nodes],
    }
    text = json.dumps(header).encode()
    parts = [MAGIC, struct.pack("<I", len(text)), text]
    for node in accumulator.nodes:
        parts.append(node.sums.tobytes())
        if node.layers is not None:
            parts.append(node.layers.tobytes())
    body = b"".join(parts)
    return body + struct.pack("<I", zlib.crc32(body))


def decode(data: bytes, tile: Tile, replicates: int, key: str) -> TileAccumulator | None:
    """The accumulator, or None where the bytes are broken, cut short, or of another render."""
    try:
        return _decode(data, tile, replicates, key)
    except (ValueError, KeyError, TypeError, struct.error):
        return None


def _decode(data: bytes, tile: Tile, replicates: int, key: str) -> TileAccumulator | None:
    if data[: len(MAGIC)] != MAGIC or zlib.crc32(memoryview(data)[:-4]) != struct.unpack("<I", data[-4:])[0]:
        return None
    at = len(MAGIC) + 4
    (length,) = struct.unpack_from("<I", data, len(MAGIC))
    header = json.loads(data[at : at + length])
    at += length
    if header["key"] != key or header["tile"] != [tile.x, tile.y, tile.width, tile.height]:
        return None
    shape = (replicates, tile.height, tile.width)
    nodes = []
    for first, count, has_layers in header["nodes"]:
        sums, at = _sums(data, at, empty_sums(shape, wide=count > FLOAT32_SAMPLES))
        layers = None
        if has_layers:
            layers, at = _filled(data, at, np.empty(shape, LAYERS))
        nodes.append(SumNode(tile, first, count, sums, layers))
    if at != len(data) - 4 or header["replicates"] != replicates:
        return None
    return TileAccumulator(tile, replicates, nodes)


def _sums(data: bytes, at: int, sums: Sums) -> tuple[Sums, int]:
    for array in (sums.planes, sums.counts, sums.rays):
        _, at = _filled(data, at, array)
    return sums, at


def _filled(data: bytes, at: int, array: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """The array with the bytes from `at` on, and where they end. Raises ValueError where there are too few."""
    array[...] = np.frombuffer(data, array.dtype, array.size, at).reshape(array.shape)
    return array, at + array.nbytes
