"""Makes OBJ files whose faces count backwards readable for trimesh, which counts from the end of the file.

In OBJ -1 is the newest vertex (or texture coordinate, or normal) at the line where it stands. Such faces are
rewritten with indices from 1; all else stays as it is.
"""

from __future__ import annotations

import re
from typing import Final

from penumbra_kernels.assets import AssetError

_BACKWARDS: Final = re.compile(rb"^\s*f\s[^\n]*(?<=[\s/])-", re.MULTILINE)
_ZERO: Final = re.compile(rb"^\s*f\s[^\n]*(?<=[\s/])0+(?=[/\s]|\Z)", re.MULTILINE)
_KINDS: Final = (b"v", b"vt", b"vn")
"""In the order in which a face's corner refers to them."""


def with_absolute_indices(data: bytes) -> bytes:
    """The same file, its faces counting from 1. Raises AssetError where they refer to nothing."""
    if _ZERO.search(data):
        raise AssetError("a face refers to index 0, but OBJ counts from 1")
    if not _BACKWARDS.search(data):
        return data
    counts = dict.fromkeys(_KINDS, 0)
    lines = data.split(b"\n")
    for number, line in enumerate(lines):
        words = line.split()
        if not words:
            continue
        if words[0] in counts:
            counts[words[0]] += 1
        elif words[0] == b"f" and b"-" in line:
            corners = [_corner(word, counts, number + 1) for word in words[1:]]
            lines[number] = b"f " + b" ".join(corners)
    return b"\n".join(lines)


def _corner(word: bytes, counts: dict[bytes, int], line: int) -> bytes:
    """One corner of a face, such as 3/-1/2."""
    parts = word.split(b"/")
    for i, (part, kind) in enumerate(zip(parts, _KINDS, strict=False)):
        if part.startswith(b"-") and part[1:].isdigit():
            index = counts[kind] - int(part[1:]) + 1
            if index < 1:
                raise AssetError(
                    f"line {line} refers to {part.decode()}, but there are only {counts[kind]} before it"
                )
            parts[i] = b"%d" % index
    return b"/".join(parts)


def beyond_the_end(data: bytes) -> str:
    """Which face refers to what the whole file does not have, counted as the file does: from 1."""
    lines = [line.split() for line in data.split(b"\n")]
    counts = {kind: sum(words[:1] == [kind] for words in lines) for kind in _KINDS}
    for number, words in enumerate(lines):
        for word in words[1:] if words[:1] == [b"f"] else ():
            for part, kind in zip(word.split(b"/"), _KINDS, strict=False):
                if part.isdigit() and int(part) > counts[kind]:
                    what = f"{kind.decode()} {int(part)}"
                    return f"line {number + 1} refers to {what}, but there are only {counts[kind]} of them"
    return "a face refers to what is not there"
