"""What the service and a worker say to each other: plain picklable values, never scenes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from penumbra_service.engine.protocol import (
    DeviceDescription,
    Lease,
    LeaseFailure,
    LeaseLost,
    LeaseResult,
    RenderSpec,
)
from penumbra_service.store.content import asset_file
from penumbra_service.store.contents import ContentStore, digest_of

Answer = LeaseResult | LeaseFailure | LeaseLost
_ASSET: Final = re.compile(rb'"sha256:([0-9a-f]{64})"')


class NotPortableError(ValueError):
    """The scene names files that other machines do not have."""


@dataclass(frozen=True)
class Contents:
    """What a lease's scene needs, by content."""

    url: str
    """Of the ContentStore."""
    scene: str
    """SHA-256 of the scene's JSON."""
    assets: tuple[str, ...]
    """SHA-256 of the assets that it names."""


@dataclass(frozen=True)
class FarmLease:
    """A lease on its way to a worker. Paths in its spec are the service's and mean nothing there."""

    lease: Lease
    contents: Contents


@dataclass(frozen=True)
class Joined:
    """A worker as it describes itself."""

    device: DeviceDescription
    kernel_hash: str
    """Of the worker's kernels: sums of different kernels are never mixed."""
    version: str


def publish(spec: RenderSpec, store: ContentStore, url: str) -> Contents:
    """Put a scene and its assets where workers can fetch them. Raises OSError, NotPortableError."""
    if spec.scene_folder is not None:
        raise NotPortableError("scenes with files beside them render on this machine only: upload the files")
    path = Path(spec.scene_path)
    scene = digest_of(path)
    assets = tuple(sorted({match.decode() for match in _ASSET.findall(path.read_bytes())}))
    for sha256 in assets:
        file = _asset(spec, sha256)
        if file is not None:  # the worker tells of a missing one, as a local device does
            store.put(sha256, file)
    store.put(scene, path)
    return Contents(url, scene, assets)


def _asset(spec: RenderSpec, sha256: str) -> Path | None:
    file = None if spec.assets_folder is None else asset_file(Path(spec.assets_folder), sha256)
    return file if file is not None and file.is_file() else None
