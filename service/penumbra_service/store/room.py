"""Disks and quotas that are full: they may have room again."""

from __future__ import annotations

import errno


def is_full(error: BaseException) -> bool:
    """Whether a disk or a quota is full."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
