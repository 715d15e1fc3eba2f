"""Naming the processor that PoCL compiles for, where its LLVM is older than the processor.

PoCL asks LLVM for the host's name. An LLVM that does not know the model (14, in the PoCL 3.0 wheel, knows no AMD family 26)
answers `generic`, which its own front end then refuses: no kernel builds (pocl issue 1049, still open). There is no option or
environment variable for it. So the name is set where PoCL keeps it: in its device record, the field `llvm_cpu`, which stands
right behind `llvm_target_triplet`. The pair "<machine>-...-linux-gnu", "generic" identifies it; where exactly one such pair is
not found, nothing is touched. Linux only, like the wheel.
"""

from __future__ import annotations

import ctypes
import os
import re
import struct
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Final

UNKNOWN: Final = b"generic"
_TRIPLE: Final = re.compile(rb"x86_64-[a-z0-9_]+-linux-[a-z0-9]+\Z")
_RECORD_BYTES: Final = 1024
"""The pair is at byte 632 in PoCL 3.0; the record is longer than this."""
_WORD: Final = struct.Struct("=Q")

_SKYLAKE: Final = frozenset({"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "avx2", "fma"})
_ICELAKE: Final = _SKYLAKE | {
    "avx512ifma", "avx512vbmi", "avx512_vbmi2", "avx512_bitalg", "avx512_vnni", "avx512_vpopcntdq",
    "gfni", "vaes", "vpclmulqdq", "sha_ni",
}  # fmt: skip

TARGETS: Final[tuple[tuple[str, frozenset[str]], ...]] = (
    ("icelake-server", _ICELAKE),
    ("skylake-avx512", _SKYLAKE),
    ("haswell", frozenset({"avx2", "fma", "bmi1", "bmi2", "f16c", "movbe"})),
    ("x86-64", frozenset()),
)
"""LLVM's names from the most able on, with the features in /proc/cpuinfo that each needs. They match the built-in
libraries that PoCL chooses by features (avx512, avx2, sse2)."""

_named: dict[int, str] = {}
"""By device record, what was set: PoCL's own text goes on saying `generic`."""
_texts: dict[str, ctypes.Array[ctypes.c_char]] = {}
"""Keeps the names alive that PoCL's records point to."""


def target_for(features: Iterable[str]) -> str:
    """The most able target whose features are all there."""
    have = frozenset(features)
    return next(name for name, needs in TARGETS if needs <= have)


def host_features() -> frozenset[str]:
    """The flags of the first processor in /proc/cpuinfo."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return frozenset()
    line = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    return frozenset(line.group(1).split()) if line else frozenset()


def find_unknown(record: bytes, read: Reader) -> int | None:
    """Byte offset of the pointer to `generic` behind a pointer to a target triple; None unless there is exactly one."""
    words = [word for (word,) in _WORD.iter_unpack(record[: len(record) // 8 * 8])]
    found = [
        8 * (i + 1)
        for i, (triple, cpu) in enumerate(pairwise(words))
        if read.string(cpu) == UNKNOWN and _TRIPLE.match(read.string(triple))
    ]
    return found[0] if len(found) == 1 else None


class Reader:
    """This process's memory, read so that wrong addresses are an answer and no fault."""

    def __init__(self) -> None:
        self._file = os.open("/proc/self/mem", os.O_RDONLY)

    def data(self, address: int, count: int) -> bytes:
        """Up to `count` bytes; empty where nothing is mapped."""
        try:
            return os.pread(self._file, count, address)
        except (OSError, OverflowError):
            return b""

    def string(self, address: int) -> bytes:
        """What a C string of at most 63 bytes holds; empty where there is none."""
        data, end, _ = self.data(address, 64).partition(b"\0")
        return data if end else b""

    def close(self) -> None:
        os.close(self._file)


def name_target(device_address: int) -> str | None:
    """Sets the target of a PoCL device whose processor its LLVM does not know; the name set, or None where nothing was.

    device_address: of PoCL's device record (a cl_device_id).
    """
    if device_address in _named:
        return _named[device_address]
    if not Path("/proc/self/mem").exists():
        return None
    reader = Reader()
    try:
        offset = find_unknown(reader.data(device_address, _RECORD_BYTES), reader)
    finally:
        reader.close()
    if offset is None:
        return None
    name = target_for(host_features())
    text = _texts.setdefault(name, ctypes.create_string_buffer(name.encode()))
    ctypes.c_uint64.from_address(device_address + offset).value = ctypes.addressof(text)
    _named[device_address] = name
    return name
