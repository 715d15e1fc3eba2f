"""What packages add to the command line, by entry points.

Those of Penumbra's own distribution come first, and others are read only where these do not suffice: to look through
all that is installed takes tens of milliseconds, which every command would wait for.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from typing import Final

DISTRIBUTION: Final = "penumbra-render"


def entry_points(group: str) -> Iterator[metadata.EntryPoint]:
    """All of a group, each once, our own first."""
    own: tuple[metadata.EntryPoint, ...] = ()
    with suppress(metadata.PackageNotFoundError):
        own = tuple(metadata.distribution(DISTRIBUTION).entry_points.select(group=group))
    yield from own
    yield from (point for point in metadata.entry_points(group=group) if point not in own)


def entry_point(group: str, name: str) -> metadata.EntryPoint | None:
    """The one of that name, if there is one."""
    return next((point for point in entry_points(group) if point.name == name), None)


def version() -> str:
    """Penumbra's."""
    return metadata.version(DISTRIBUTION)
