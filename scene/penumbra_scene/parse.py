"""Bytes -> Scene or JobRequest, or a ProblemError that says what is wrong, where, and what is accepted.

JSON is taken strictly: UTF-8, no byte-order mark, no key twice, no half surrogate pairs.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

from pydantic import ValidationError

from penumbra_scene import limits
from penumbra_scene.check import SceneError, check_scene
from penumbra_scene.errors import (
    ProblemError,
    ProblemItem,
    invalid_document,
    make_problem,
    pointer,
    printable,
    problem_from_validation,
    shorten,
)
from penumbra_scene.job import OVERRIDES, JobRequest
from penumbra_scene.scene import Scene

_MOST_DIGITS: Final = 400
"""More digits than any double has."""


class _Flawed(dict[str, Any]):
    """An object that JSON parsers differ about; `flaw` says why."""

    flaw: str


def _not_json(message: str, given: str = "") -> ProblemError:
    item = ProblemItem(pointer="", message=message, given=given, accepted="JSON (RFC 8259) in UTF-8")
    return ProblemError(make_problem("not-json", "The body is not JSON", 422, message, [item]))


def parse_json(data: bytes, limit: int = limits.MAX_BODY_BYTES) -> Any:
    """The JSON value that `data` holds. Raises ProblemError: 413 if it is too long, 422 if it is not JSON.

    NaN, Infinity and numbers beyond a double's range come through as such: no model accepts them, and the
    error then says where they stand.
    """
    if len(data) > limit:
        detail = f"given {len(data)} bytes, accepted at most {limit}"
        raise ProblemError(make_problem("too-large", "The body is too long", 413, detail))
    if data.startswith(b"\xef\xbb\xbf"):
        raise _not_json("it begins with a byte-order mark", "EF BB BF")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _not_json(f"byte {error.start} is not UTF-8", f"{data[error.start]:02X}") from None
    return _loads(text)


def _loads(text: str) -> Any:
    flawed: list[_Flawed] = []

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        flaw = _flaw(pairs, found)
        if flaw is None:
            return found
        flawed.append(_Flawed(found))
        flawed[-1].flaw = flaw
        return flawed[-1]

    try:
        body = json.loads(text, object_pairs_hook=unique, parse_int=_integer)
    except json.JSONDecodeError as error:
        excerpt = shorten(text[max(error.pos - 10, 0) : error.pos + 10])
        raise _not_json(f"line {error.lineno}, column {error.colno}: {error.msg}", excerpt) from None
    except RecursionError:
        raise _not_json("arrays and objects are nested too deeply") from None
    if flawed:
        raise _ambiguous(body)
    return body


def _flaw(pairs: list[tuple[str, Any]], found: dict[str, Any]) -> str | None:
    if len(found) < len(pairs):
        twice = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        return f"has the key {shorten(twice)} twice"
    for key in found:
        if not key.isascii() and any("\ud800" <= character <= "\udfff" for character in key):
            return f"has the key {shorten(key)}, which holds half a surrogate pair"
    return None


def _ambiguous(body: Any) -> ProblemError:
    items: list[ProblemItem] = []
    pending: list[tuple[tuple[str | int, ...], Any]] = [((), body)]
    while pending:
        path, value = pending.pop()
        if isinstance(value, _Flawed):
            items.append(_flaw_item(path, value))
        if isinstance(value, dict):
            pending += [((*path, key), child) for key, child in value.items()]
        elif isinstance(value, list):
            pending += [((*path, i), child) for i, child in enumerate(value)]
    return ProblemError(invalid_document(items[::-1]))


def _flaw_item(path: tuple[str | int, ...], value: _Flawed) -> ProblemItem:
    accepted = "an object in which every key stands once, in valid Unicode"
    at = printable(pointer(path))
    return ProblemItem(pointer=at, message=value.flaw, given=shorten(value), accepted=accepted)


def _integer(digits: str) -> int | float:
    """Python converts huge integers in quadratic time; what no double can hold is infinite to us."""
    return int(digits) if len(digits) <= _MOST_DIGITS else float(digits)


def scene_from_json(body: Any, *, allow_files: bool = False) -> Scene:
    """A checked scene from a parsed document. Raises ProblemError (422)."""
    try:
        scene = Scene.model_validate(body)
    except ValidationError as error:
        raise ProblemError(problem_from_validation(error, body, "scene")) from None
    _raise_errors(check_scene(scene, allow_files=allow_files), "scene")
    return scene


def parse_scene(data: bytes, *, allow_files: bool = False) -> Scene:
    """A checked scene from bytes; `allow_files` on the command line only. Raises ProblemError."""
    return scene_from_json(parse_json(data), allow_files=allow_files)


def job_from_json(body: Any, *, allow_files: bool = False) -> JobRequest:
    """A checked job; `allow_files` on the command line only. Raises ProblemError (422)."""
    try:
        request = JobRequest.model_validate(body)
    except ValidationError as error:
        raise ProblemError(problem_from_validation(error, body, "job")) from None
    rename = _job_pointers(request)
    _raise_errors(check_scene(request.resolved_scene(), allow_files=allow_files), "job", rename)
    return request


def parse_job(data: bytes) -> JobRequest:
    """A checked job from bytes. Raises ProblemError."""
    return job_from_json(parse_json(data))


def _job_pointers(request: JobRequest) -> Callable[[str], str]:
    """Where a place in the resolved scene stands in the job's document."""
    replaced = {key for key in OVERRIDES if getattr(request, key) is not None}

    def rename(pointer: str) -> str:
        head = pointer.split("/")[1] if pointer else ""
        return pointer if head in replaced else "/scene" + pointer

    return rename


def _raise_errors(
    found: list[SceneError], what: str, rename: Callable[[str], str] = lambda pointer: pointer
) -> None:
    items = [
        ProblemItem(pointer=rename(e.pointer), message=e.message, given=e.given, accepted=e.accepted)
        for e in found
        if not e.warning
    ]
    if items:
        raise ProblemError(invalid_document(items, what))
