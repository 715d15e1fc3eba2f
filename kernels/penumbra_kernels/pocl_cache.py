"""PoCL's own program cache, made a scratch folder of this process.

PoCL keeps what it compiles under POCL_CACHE_DIR: without checksums, without a limit, and for good. It also compiles late: a
kernel's machine code is made at the first launch of each work-group size, after the point at which most programs take the
binary. So Penumbra takes binaries after a first launch, keeps them in a cache of its own (cache.py), and gives PoCL an empty
folder that goes with the process. Whoever sets POCL_CACHE_DIR keeps PoCL's shared cache, and its late compilation.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import os
import shutil
import tempfile
from pathlib import Path
from typing import Final

VARIABLE: Final = "POCL_CACHE_DIR"
LAUNCHED: Final = "1-1-1-goffs0-smallgrid"
"""What PoCL 3 calls the code for work-groups of one item, grids below 65,535 and no offset: tracer.py launches no other."""
ANY_SIZE: Final = "0-0-0"
"""The code for any size, which PoCL adds to every binary and which nothing here launches."""

_scratch: Path | None = None
_lock: int | None = None


def scratch() -> Path | None:
    """This process's scratch folder; None where PoCL uses a folder that somebody named."""
    return _scratch


def own_environment() -> dict[str, str]:
    """The environment for a child that shall have a scratch folder of its own."""
    hidden = {VARIABLE} if _scratch is not None else set()
    return {key: value for key, value in os.environ.items() if key not in hidden}


def take_scratch(root: Path) -> None:
    """Point PoCL at a new folder under `root`, and sweep away those of processes that were killed. PoCL reads the variable
    when its devices are first asked for, so this comes before. Does nothing where the variable is set, or nothing can be
    written."""
    global _scratch, _lock
    if VARIABLE in os.environ:
        return
    try:
        root.mkdir(parents=True, exist_ok=True)
        _sweep(root)
        folder = Path(tempfile.mkdtemp(prefix="pocl-", dir=root))
        _lock = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o600)
        fcntl.flock(_lock, fcntl.LOCK_EX)
    except OSError:
        return
    _scratch = folder
    os.environ[VARIABLE] = str(folder / "kernels")
    atexit.register(leave_scratch)


def leave_scratch() -> None:
    """Remove this process's scratch folder: it is about to end."""
    if _scratch is not None:
        shutil.rmtree(_scratch, ignore_errors=True)


def _sweep(root: Path) -> None:
    """Remove scratch folders whose lock nobody holds: their processes are gone. One without a lock is just being made."""
    for lock in root.glob("pocl-*/lock"):
        with contextlib.suppress(OSError):
            handle = os.open(lock, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(lock.parent, ignore_errors=True)
            finally:
                os.close(handle)


def compiled() -> dict[str, int]:
    """Machine code in the scratch folder: path -> time of its last change, nanoseconds. A compilation changes it."""
    if _scratch is None:
        return {}
    return {str(path): path.stat().st_mtime_ns for path in _scratch.rglob("*.so")}


def spare_any_size() -> None:
    """Give every kernel that has been launched its launched code as the code for any size, which PoCL would otherwise
    compile when the binary is taken: a third of a cold start. PoCL prefers the code for the exact size, and compiles what
    is missing from the binary's intermediate code, so the stand-in never runs."""
    if _scratch is None:
        return
    for launched in _scratch.glob(f"kernels/*/*/*/{LAUNCHED}/*.so"):
        folder = launched.parent.parent / ANY_SIZE
        with contextlib.suppress(OSError):
            folder.mkdir()
            os.link(launched, folder / launched.name)
