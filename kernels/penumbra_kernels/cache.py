"""The cache folder, and in it built programs, keyed by all that they depend on. A broken entry is rebuilt, never fatal."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from penumbra_scene.exits import Exit

if TYPE_CHECKING:
    from penumbra_kernels.device import DeviceInfo

MAX_BYTES: Final = 512 * 1024 * 1024
"""Of all entries, unless PENUMBRA_CACHE_BYTES says otherwise; those that were not used for longest go first."""
ABANDONED_SECONDS: Final = 3600.0
"""A temporary file of that age was left by a process that was killed."""
VARIABLE: Final = "PENUMBRA_CACHE"
SIZE_VARIABLE: Final = "PENUMBRA_CACHE_BYTES"
PROGRAMS: Final = "programs"
"""The folder of built programs and large trees."""
_DIGEST: Final = 32


class CacheError(Exception):
    """The cache cannot be as it is asked for; the message says by which variable, what was given and what is accepted."""

    exit_code = Exit.USAGE


def folder() -> Path:
    """PENUMBRA_CACHE, or penumbra under the user's cache folder."""
    root = os.environ.get(VARIABLE)
    if root:
        return Path(root)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "penumbra"


def check() -> None:
    """Raises CacheError where the cache folder is no folder, nor could become one, or its size is no number. A folder that
    cannot be written is accepted: it may hold all that is needed."""
    path, size = folder(), os.environ.get(SIZE_VARIABLE, "")
    if size and not size.isdecimal():
        raise CacheError(f"{SIZE_VARIABLE}: given {size!r}, accepted: a whole number of bytes")
    try:
        check_folder(path)
    except OSError as error:
        raise _refused(path, error) from error


def made(name: str) -> Path:
    """The folder of that name in the cache folder, made if need be. Raises CacheError where it cannot be written."""
    check()
    path = folder() / name
    try:
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise _refused(path, error) from error
    return path


def check_folder(path: Path) -> None:
    """Raises OSError where `path` is no folder, nor could become one, since there is something else on its way."""
    nearest = next((place for place in (path, *path.parents) if place.exists()), None)
    if nearest is not None and not nearest.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(nearest))


def _refused(path: Path, error: OSError) -> CacheError:
    given = os.environ.get(VARIABLE)
    told = f"given {given!r}" if given else "not given"
    return CacheError(
        f"{VARIABLE}: {told}, but {error.filename or path}: {error.strerror}; accepted: a folder that can be written, or a "
        "path where one can be made"
    )


def put(path: Path, data: bytes) -> None:
    """Write a file of the cache, wholly or not at all; a folder in its place gives way. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        Path(temporary).replace(path)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
        raise


def capacity() -> int:
    """Bytes that all entries together may have: PENUMBRA_CACHE_BYTES, or MAX_BYTES."""
    text = os.environ.get(SIZE_VARIABLE, "")
    return int(text) if text.isdecimal() else MAX_BYTES


def key(source: str, options: Sequence[str], device: DeviceInfo) -> str:
    """SHA-256 of the flattened source (flags are its first lines), build options, device, driver and platform; a PoCL
    platform's version names PoCL's release and LLVM's, and the bit class the processor that it compiles for."""
    return _digest(source, tuple(options), device.platform, device.bit_class)


@lru_cache(16)
def _digest(source: str, *more: str | tuple[str, ...]) -> str:
    """A scene asks for the keys of its few programs several times, and the next scene for most of them again."""
    return hashlib.sha256(json.dumps([source, *more]).encode()).hexdigest()


def _path(key: str) -> Path:
    return folder() / PROGRAMS / f"{key}.bin"


def has(key: str) -> bool:
    """Whether there is an entry, sound or not."""
    return _path(key).is_file()


def is_empty() -> bool:
    """Whether there is no program at all."""
    return next((folder() / PROGRAMS).glob("*.bin"), None) is None


def load(key: str) -> bytes | None:
    """The binary, or None where there is none or its checksum is wrong. Counts as a use."""
    path = _path(key)
    try:
        data = path.read_bytes()
    except OSError:
        return None
    digest, binary = data[:_DIGEST], data[_DIGEST:]
    if hashlib.sha256(binary).digest() != digest:
        discard(key)
        return None
    note_use(key)
    return binary


def note_use(key: str) -> None:
    """What was used last is kept longest."""
    with contextlib.suppress(OSError):
        os.utime(_path(key))


def store(key: str, binary: bytes) -> None:
    """Write atomically; a full or read-only disk only means that the next start compiles again."""
    path = _path(key)
    try:
        put(path, hashlib.sha256(binary).digest() + binary)
    except OSError:
        return
    _trim(path.parent)


def discard(key: str) -> None:
    """Forget an entry."""
    with contextlib.suppress(OSError):
        _path(key).unlink()


def _trim(programs: Path) -> None:
    entries = []
    for path in programs.glob("*.bin"):
        with contextlib.suppress(OSError):
            status = path.stat()
            entries.append((status.st_mtime_ns, status.st_size, path))
    total, limit = sum(size for _, size, _ in entries), capacity()
    for _, size, path in sorted(entries):
        if total <= limit:
            break
        with contextlib.suppress(OSError):
            path.unlink()
        total -= size
    for path in programs.glob("*.tmp"):
        with contextlib.suppress(OSError):
            if time.time() - path.stat().st_mtime > ABANDONED_SECONDS:
                path.unlink()
