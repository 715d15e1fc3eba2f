"""What a run keeps beside its tiles, so that another process can go on: written before anything that depends
on it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from penumbra_kernels.program import CL_ROOT

from penumbra_service.film.tilefile import TileStore
from penumbra_service.jobs.record import RunRecord

NAME: Final = "progress.json"
FORMAT: Final = 1


@dataclass
class Snapshot:
    """A run's state without its sums."""

    key: str
    """Names the render: what belongs to another one is not used."""
    tile_size: int
    checked: int
    open_ends: tuple[int, ...]
    """Batches that were begun: tiles hold no node that reaches across their ends."""
    record: RunRecord


def save(store: TileStore, snapshot: Snapshot) -> None:
    """Raises OSError."""
    data = {
        "format": FORMAT,
        "key": snapshot.key,
        "tile_size": snapshot.tile_size,
        "checked": snapshot.checked,
        "open_ends": list(snapshot.open_ends),
        "record": snapshot.record.to_json(),
    }
    store.write(NAME, json.dumps(data).encode())


def load(store: TileStore, key: str) -> Snapshot | None:
    """None where there is none, or it is broken or of another render."""
    text = store.read(NAME)
    if text is None:
        return None
    try:
        data: dict[str, Any] = json.loads(text)
        if data["format"] != FORMAT or data["key"] != key:
            return None
        record = RunRecord.from_json(data["record"])
        ends = tuple(int(end) for end in data["open_ends"])
        return Snapshot(key, int(data["tile_size"]), int(data["checked"]), ends, record)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


@lru_cache
def kernel_hash() -> str:
    """SHA-256 of the kernels package's sources: sums of different kernels are never mixed."""
    digest = hashlib.sha256()
    package = CL_ROOT.parent
    for path in sorted([*CL_ROOT.rglob("*"), *package.rglob("*.py")]):
        if path.is_file() and path.suffix in (".cl", ".h", ".py"):
            digest.update(str(path.relative_to(package)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
