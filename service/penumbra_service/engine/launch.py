"""Starting the processes that drive devices.

Imports only what starting takes: a command starts its first device process before it imports anything large, so that
drivers come up meanwhile. The system ends a device process with the *thread* that started it.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import IO, Final

DEVICE_COMMAND: Final = (sys.executable, "-m", "penumbra_service.engine.device_process")
FRUGAL: Final = {"OPENBLAS_NUM_THREADS": "1", "PYDANTIC_DISABLE_PLUGINS": "1"}
"""Environment of our processes, where it says nothing else: numpy's BLAS starts a thread for every core, which spins for
some 40 ms, and nothing here multiplies large matrices; pydantic looks through all that is installed for plugins."""
STDERR_TAIL: Final = 2000
"""Bytes of a dead process's last words that its reason quotes."""


@dataclass
class Child:
    """A device process and our end of its socket."""

    process: subprocess.Popen[bytes]
    connection: Connection
    words: IO[bytes]
    """What it writes to its standard output and error."""

    def last_words(self) -> str:
        """The end of what it said."""
        size = self.words.seek(0, os.SEEK_END)
        self.words.seek(max(size - STDERR_TAIL, 0))
        return self.words.read().decode(errors="replace").strip()

    def end(self) -> None:
        """Whatever it is at."""
        with contextlib.suppress(OSError):
            self.connection.close()
        self.process.kill()
        self.process.wait()
        self.words.close()


def be_frugal() -> None:
    """Take FRUGAL over: for a command, before it imports numpy or pydantic."""
    for name, value in FRUGAL.items():
        os.environ.setdefault(name, value)


def start_child(command: Sequence[str], *arguments: str) -> Child:
    """Raises OSError where no process or descriptor is left."""
    ours, theirs = Pipe()
    words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
    try:
        process = subprocess.Popen(
            [*command, *arguments, "--fd", str(theirs.fileno()), "--parent", str(os.getpid())],
            pass_fds=[theirs.fileno()],
            env={**FRUGAL, **os.environ},
            stdin=subprocess.DEVNULL,
            stdout=words,
            stderr=words,
        )
    except OSError:
        ours.close()
        words.close()
        raise
    finally:
        theirs.close()
    return Child(process, ours, words)


def start_first(device_ids: Sequence[str] | None, command: Sequence[str] = DEVICE_COMMAND) -> Child:
    """A process that tells which devices there are (protocol.Devices) and goes on to drive the first of those that are
    wanted: of all, where none are named. Raises OSError."""
    return start_child(
        command, "--first", *(() if device_ids is None else ("--wanted", ",".join(device_ids)))
    )


def ids_of(text: str) -> list[str] | None:
    """Device ids from a user's text, commas between them; None for all."""
    return [part.strip() for part in text.split(",") if part.strip()] or None
