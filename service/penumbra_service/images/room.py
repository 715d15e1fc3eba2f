"""Full disks under OpenImageIO: its messages do not tell them from other failures, and what its last buffer holds is lost
without a word."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

BUFFER_BYTES: Final = 1 << 16
"""More than a C library keeps back of a file on a local disk."""


@contextmanager
def writes_into(folder: Path) -> Iterator[None]:
    """Around the writing of a file. Raises the system's OSError (ENOSPC, EDQUOT) where there is no room left in the folder
    at the end, and so where there may have been none for the file's."""
    try:
        yield
    except OSError:
        _demand_room(folder)
        raise
    _demand_room(folder)


def _demand_room(folder: Path) -> None:
    with tempfile.TemporaryFile(dir=folder, buffering=0) as probe:
        left = max(BUFFER_BYTES, os.fstat(probe.fileno()).st_blksize)
        while left > 0:  # a write may take a part, and the next one tell why
            left -= probe.write(bytes(left))
