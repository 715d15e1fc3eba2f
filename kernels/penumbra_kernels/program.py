"""Assembling a program's text: the prologue of 0/1 flags, then the sources flattened with `#line` kept."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

CL_ROOT: Final = Path(__file__).parent / "cl"

_IF: Final = re.compile(r"^\s*#\s*if")
_ENDIF: Final = re.compile(r"^\s*#\s*endif")
_INCLUDE: Final = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')

BUILD_OPTIONS: Final = ("-cl-std=CL1.2",)
"""The same for every program. No fast-math of any kind: error bounds and equal bits depend on IEEE arithmetic."""


def flatten(text: str, name: str, unconditional: set[str], depth: int = 0) -> str:
    """Inline every `#include "path"` (relative to cl/), keeping file names and lines for error messages.

    unconditional: files whose text stands outside every #if so far; they are not written again. A file that is reached
    inside an #if is written there under a guard, since that text may be compiled away.
    depth: #if blocks around this text.
    """
    out = [f'#line 1 "{name}"']
    for number, line in enumerate(text.splitlines(), start=1):
        depth += bool(_IF.match(line)) - bool(_ENDIF.match(line))
        match = _INCLUDE.match(line)
        if not match:
            out.append(line)
            continue
        out.append(_included(match.group(1), unconditional, depth))
        out.append(f'#line {number + 1} "{name}"')
    return "\n".join(out)


def _included(path: str, unconditional: set[str], depth: int) -> str:
    if path in unconditional:
        return ""
    if depth == 0:
        unconditional.add(path)
    guard = "PENUMBRA_HAS_" + re.sub(r"\W", "_", path).upper()
    text = flatten((CL_ROOT / path).read_text(), path, unconditional, depth)
    return f"#if !{guard}\n#define {guard} 1\n{text}\n#endif"


def assemble(entry: str, flags: Mapping[str, int], text: str | None = None) -> str:
    """The whole text of a program.

    entry: file under cl/ that holds the kernels, or, where `text` is given, a name for that text.
    flags: macro name -> integer; numbers only, so that no text of a user ever reaches a compiler.
    """
    for key, value in flags.items():
        if not re.fullmatch(r"PENUMBRA_[A-Z0-9_]+", key) or not isinstance(value, int):
            raise ValueError(f"flag {key}={value!r}: flags are PENUMBRA_* macros with integer values")
    prologue = "".join(f"#define {key} {int(value)}\n" for key, value in sorted(flags.items()))
    body = _entry(entry) if text is None else flatten(text, entry, {entry})
    return prologue + "#pragma OPENCL FP_CONTRACT OFF\n" + body


@cache
def _entry(name: str) -> str:
    """A file under cl/, flattened. Once: a program's text is asked for several times, by its key and to build it."""
    return flatten((CL_ROOT / name).read_text(), name, {name})


def source_hash(source: str) -> str:
    """SHA-256 of a program's text, hexadecimal."""
    return hashlib.sha256(source.encode()).hexdigest()
