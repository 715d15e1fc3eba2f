"""Where a JSON pointer leads in the text of a document: its line, for people who look at the text."""

from __future__ import annotations

import json
from typing import Final

_DECODER: Final = json.JSONDecoder(strict=False)
_SPACE: Final = " \t\n\r"


def line_of(text: str, pointer: str) -> int | None:
    """The line (from 1) on which the value at `pointer` begins; that of its parent if the key is missing.

    None where the text is no JSON, or the pointer leads nowhere.
    """
    steps = [step.replace("~1", "/").replace("~0", "~") for step in pointer.split("/")[1:]]
    try:
        at = _skip(text, 0)
        for step in steps:
            found = _child(text, at, step)
            if found is None:
                break
            at = found
    except (ValueError, IndexError, RecursionError):
        return None
    return text.count("\n", 0, at) + 1


def _skip(text: str, at: int) -> int:
    while text[at] in _SPACE:
        at += 1
    return at


def _child(text: str, at: int, step: str) -> int | None:
    """Where the member or item `step` of the value that begins at `at` begins."""
    if text[at] == "{":
        return _member(text, _skip(text, at + 1), step)
    if text[at] == "[" and step.isdigit():
        return _item(text, _skip(text, at + 1), int(step))
    return None


def _member(text: str, at: int, wanted: str) -> int | None:
    while text[at] == '"':
        key, at = _DECODER.raw_decode(text, at)
        at = _skip(text, _skip(text, at) + 1)  # past the colon
        if key == wanted:
            return at
        at = _next(text, at)
    return None


def _item(text: str, at: int, wanted: int) -> int | None:
    for _ in range(wanted):
        if text[at] == "]":
            return None
        at = _next(text, at)
    return None if text[at] == "]" else at


def _next(text: str, at: int) -> int:
    """Past the value at `at`, and past the comma behind it, if there is one."""
    at = _skip(text, _DECODER.raw_decode(text, at)[1])
    return _skip(text, at + 1) if text[at] == "," else at
