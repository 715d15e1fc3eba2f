"""Building large trees in a process of its own.

    python -m penumbra_kernels.accel.apart --parent PID     reads a folder a line, builds the tree over what lies in it

numba and its LLVM take some 135 MB and a build some 125 bytes an item beyond its input; whoever holds the scene would keep
them for good. This process goes when nothing was asked of it for IDLE_SECONDS, and they with it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels import cache as disk
from penumbra_kernels.accel.build import Items, Tree, build_tree, tree_from_bytes, tree_to_bytes
from penumbra_kernels.child import die_with

COMMAND: Final = (sys.executable, "-m", "penumbra_kernels.accel.apart")
IDLE_SECONDS: Final = 5.0
"""Frames of a sequence may follow each other so slowly that none of them waits for numba anew."""
INPUTS: Final = ("lo", "hi", "key", "word")
_TREE: Final = "tree"
_COPIES: Final = "copies"
_DONE: Final = b"done\n"
_PREFIX: Final = "tree-"


class TreeBuilder:
    """Builds as build_tree does, elsewhere; where that fails, here. For one thread: the process ends with it."""

    def __init__(self, command: tuple[str, ...] = COMMAND) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None

    def __call__(self, items: Items, copies: NDArray[np.int64]) -> Tree:
        """Raises TreeError."""
        try:
            return self._elsewhere(items, copies)
        except OSError:
            return build_tree(items, copies)

    def close(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._end()

    def _elsewhere(self, items: Items, copies: NDArray[np.int64]) -> Tree:
        root = disk.folder()
        root.mkdir(parents=True, exist_ok=True)
        _sweep(root)
        with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=root) as name:
            folder = Path(name)
            for part in INPUTS:
                np.save(folder / f"{part}.npy", getattr(items, part))
            np.save(folder / f"{_COPIES}.npy", copies)
            self._ask(folder)
            return tree_from_bytes((folder / _TREE).read_bytes())

    def _ask(self, folder: Path) -> None:
        """Have it built. Raises OSError where the process cannot."""
        started = self._process is None
        self._process = self._process or self._start()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(f"{folder}\n".encode())
        if self._process.stdout.readline() == _DONE:
            return
        self._end()
        if started:
            raise OSError("the process that builds trees ended")
        self._ask(folder)  # the one from before has ended since nothing was asked of it

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [*self._command, "--parent", str(os.getpid())],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def _end(self) -> None:
        assert self._process is not None
        self._process.communicate()
        self._process = None


def _sweep(root: Path) -> None:
    """Remove what processes that were killed have left."""
    for folder in root.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - folder.stat().st_mtime > disk.ABANDONED_SECONDS:
                shutil.rmtree(folder, ignore_errors=True)


def build_in(folder: Path) -> None:
    """From the arrays in a folder to the tree beside them. Raises TreeError."""
    items = Items(*(np.load(folder / f"{part}.npy", mmap_mode="r") for part in INPUTS))
    tree = build_tree(items, np.load(folder / f"{_COPIES}.npy"))
    (folder / _TREE).write_bytes(tree_to_bytes(tree))


def main() -> None:
    """The process's whole life: until its standard input ends, or nothing comes."""
    parser = argparse.ArgumentParser(prog="apart", description="Builds Penumbra's trees.")
    parser.add_argument("--parent", type=int, help="process id to die with")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what it means
    die_with(parser.parse_args().parent)
    while select.select([sys.stdin], [], [], IDLE_SECONDS)[0]:
        line = sys.stdin.readline()
        if not line:
            return
        build_in(Path(line.removesuffix("\n")))
        sys.stdout.write(_DONE.decode())
        sys.stdout.flush()


if __name__ == "__main__":
    main()
