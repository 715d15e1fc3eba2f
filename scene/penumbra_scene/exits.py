"""Exit codes of the `penumbra` command, for scripts: the same for every command."""

from __future__ import annotations

from enum import IntEnum


class Exit(IntEnum):
    """What a command's exit status means."""

    OK = 0
    """Done."""
    INTERNAL = 1
    """A mistake of Penumbra's own; please report it."""
    USAGE = 2
    """The command line is wrong, or a file that it names cannot be read or written."""
    INVALID = 3
    """The scene, or a file that it names, is not valid."""
    UNREACHABLE = 4
    """No service answers at that address."""
    FAILED = 5
    """The job failed; its reason is printed."""
    CANCELLED = 6
    """The job was cancelled."""
    DEVICE = 7
    """There is no usable OpenCL device, or it failed."""
    REFUSED = 8
    """The service refused: key missing or wrong, unknown job, over a limit, or a mistake of its own."""
    INTERRUPTED = 130
    """Stopped by Ctrl-C."""
    TERMINATED = 143
    """Stopped by SIGTERM."""
