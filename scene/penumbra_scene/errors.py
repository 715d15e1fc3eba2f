"""The one shape of every error: problem+json (RFC 9457) with JSON pointers (RFC 6901) into the document.

Each entry says where (`pointer`), what was `given`, what is `accepted`, and what is wrong (`message`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

from pydantic import Field, ValidationError

from penumbra_scene import limits
from penumbra_scene.base import Model
from penumbra_scene.describe import accepted_at
from penumbra_scene.transforms import STEP_KEYS

MEDIA_TYPE: Final = "application/problem+json"
TYPE_PREFIX: Final = "urn:problem-type:penumbra:"
_GIVEN_LENGTH: Final = 80
NOTHING: Final = "nothing"


class ProblemItem(Model):
    """One thing that is wrong with a document."""

    pointer: str
    """JSON pointer (RFC 6901) into the document that was sent; "" is the whole of it."""
    message: str
    """What is wrong, in words."""
    given: str = ""
    """What stands there, as JSON, shortened; "nothing" where a key is missing."""
    accepted: str = ""
    """What may stand there."""


class Problem(Model):
    """An error answer, as RFC 9457 has it."""

    type: str = Field(pattern=r"^(about:blank|urn:problem-type:penumbra:[a-z-]+)$")
    """What kind of error this is: stable, for programs."""
    title: str
    """The same in words."""
    status: int = Field(ge=400, le=599)
    """The HTTP status code."""
    detail: str
    """What happened this time."""
    errors: tuple[ProblemItem, ...] = ()
    """The places in the document that are to blame; at most 50 of them."""


class ProblemError(Exception):
    """A problem on its way to whoever asked."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(_in_words(problem))
        self.problem = problem


def _in_words(problem: Problem) -> str:
    lines = [f"{problem.title}: {problem.detail}"]
    for item in problem.errors:
        line = f"  at {item.pointer or 'the top'}: {item.message}"
        if item.given:
            line += f"; given {item.given}"
        if item.accepted:
            line += f"; accepted: {item.accepted}"
        lines.append(line)
    return "\n".join(lines)


def make_problem(
    kind: str, title: str, status: int, detail: str, errors: Iterable[ProblemItem] = ()
) -> Problem:
    """A Problem whose type is urn:problem-type:penumbra:`kind`."""
    return Problem(type=TYPE_PREFIX + kind, title=title, status=status, detail=detail, errors=tuple(errors))


def invalid_document(items: Sequence[ProblemItem], what: str = "document") -> Problem:
    """422: the document is JSON, but not what it should be. Lists the first limits.MAX_ERRORS errors."""
    count = len(items)
    detail = "1 error" if count == 1 else f"{count} errors"
    if count > limits.MAX_ERRORS:
        detail += f", of which the first {limits.MAX_ERRORS} are listed"
    return make_problem(
        "invalid-document", f"The {what} is not valid", 422, detail, items[: limits.MAX_ERRORS]
    )


def problem_from_validation(error: ValidationError, body: Any, what: str = "document") -> Problem:
    """What pydantic found wrong with `body` (the parsed JSON), told in the user's terms."""
    schema = _schema_of(error.title)
    seen: dict[tuple[str, str], ProblemItem] = {}
    for entry in error.errors(include_url=False):
        if _echoes_another(entry):
            continue
        item = _item(entry, body, schema)
        seen.setdefault((item.pointer, item.message), item)
    return invalid_document(list(seen.values()), what)


_SCHEMAS: Final[dict[str, dict[str, Any]]] = {}


def _schema_of(title: str) -> dict[str, Any]:
    """The JSON Schema of the model that was validated; {} for one that is not of the contract."""
    if title not in _SCHEMAS:
        from penumbra_scene.schema import input_schema

        _SCHEMAS[title] = input_schema(title)
    return _SCHEMAS[title]


def _echoes_another(entry: Any) -> bool:
    """An array with a wrong entry also counts as too short, since validation of it ended there."""
    return bool(entry["type"] == "too_short" and len(entry["input"]) >= entry["ctx"]["min_length"])


def _item(entry: Any, body: Any, schema: dict[str, Any]) -> ProblemItem:
    kind: str = entry["type"]
    context: dict[str, Any] = entry.get("ctx", {})
    loc = [*entry["loc"], *_steps(context.get("at", ""))]
    path = resolve(loc, body) if kind != "missing" else None
    if path is None:  # the last step is a key that the document leaves out
        path = [*(resolve(loc[:-1], body) or []), loc[-1]]
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        path = [*path, str(context["discriminator"]).strip("'")]
    elif kind == "missing" and path and isinstance(path[-1], int):
        kind, path = "too_short", path[:-1]  # blame the array
    return ProblemItem(
        pointer=printable(pointer(path)),
        message=_message(kind, entry["msg"], context),
        given=given_at(body, path),
        accepted=context.get("accepted") or accepted_at(schema, body, path, parent=kind == "extra_forbidden"),
    )


def _message(kind: str, message: str, context: dict[str, Any]) -> str:
    plain = {
        "missing": "is missing",
        "union_tag_not_found": "is missing",
        "union_tag_invalid": "is not one of the accepted words",
        "too_short": "has too few entries",
        "too_long": "has too many entries",
        "string_pattern_mismatch": "does not have the accepted form",
        "literal_error": "is not one of the accepted values",
        "extra_forbidden": "is not a known key",
        "finite_number": "must be a finite number",
        "model_attributes_type": "must be an object",
        "model_type": "must be an object",
        "dict_type": "must be an object",
        "tuple_type": "must be an array",
        "string_type": "must be a string",
        "string_unicode": "must be valid Unicode text",
        "bool_type": "must be true or false",
        "float_type": "must be a number",
        "int_type": "must be a whole number",
        "int_parsing_size": "has too many digits",
        "int_from_float": "must be a whole number",
    }
    return plain.get(kind, message.removeprefix("Value error, ").replace("Input should", "must"))


def resolve(loc: Sequence[str | int], body: Any) -> list[str | int] | None:
    """Pydantic's location as a path in the user's document; None where the document has no such place.

    A location also holds names that are not in the document: tags of unions ('perspective', 'steps'). Of all
    ways to leave such elements out, take the one that leaves out the fewest, the earlier ones first.
    """
    best: tuple[list[int], list[str | int]] | None = None
    pending: list[tuple[int, Any, list[int], list[str | int]]] = [(0, body, [], [])]
    while pending:
        at, value, skipped, path = pending.pop()
        if best is not None and len(skipped) > len(best[0]):
            continue
        if at == len(loc):
            if best is None or (len(skipped), skipped) < (len(best[0]), best[0]):
                best = (skipped, path)
            continue
        key = loc[at]
        if _may_skip(value, key):
            pending.append((at + 1, value, [*skipped, at], path))
        if _has(value, key):
            pending.append((at + 1, value[key], skipped, [*path, key]))
    return best[1] if best is not None else None


def _may_skip(value: Any, key: str | int) -> bool:
    """Whether `key` can be a mere tag of `value`: its `type` word, a form of transform or colour;
    an index into what the user wrote without brackets; or the mark that blames a key itself."""
    if isinstance(key, int):
        return not isinstance(value, (list, tuple))
    if isinstance(value, dict):
        word = key in ("steps", "keyframes", "texture", "[key]") or key in STEP_KEYS
        return word or value.get("type") == key
    return key in ("steps", "color", "[key]")


def _has(value: Any, key: str | int) -> bool:
    if isinstance(key, int):
        return isinstance(value, (list, tuple)) and 0 <= key < len(value)
    return isinstance(value, dict) and key in value


def pointer(path: Iterable[str | int]) -> str:
    """RFC 6901."""
    return "".join("/" + str(key).replace("~", "~0").replace("/", "~1") for key in path)


def printable(text: str) -> str:
    """Without the half surrogate pairs that JSON can smuggle in and UTF-8 cannot carry out."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _steps(text: str) -> list[str | int]:
    steps = [step.replace("~1", "/").replace("~0", "~") for step in text.split("/")[1:]]
    return [int(step) if step.isdigit() else step for step in steps]


def given_at(body: Any, path: Sequence[str | int]) -> str:
    """What the document holds at `path`, as JSON, shortened; 'nothing' where there is no such place."""
    for key in path:
        if not _has(body, key):
            return NOTHING
        body = body[key]
    return shorten(body)


def shorten(value: Any) -> str:
    """A value as JSON, in at most some 80 characters."""
    if isinstance(value, (list, tuple)) and len(value) > 16:
        return f"an array of {len(value)}"
    if isinstance(value, dict) and len(value) > 16:
        return f"an object of {len(value)} keys"
    if isinstance(value, int) and abs(value) >= 10**40:
        return f"a number of more than {_GIVEN_LENGTH // 2} digits"
    if isinstance(value, float) and math.isinf(value):
        return "a number beyond 1e308" if value > 0 else "a number below -1e308"
    try:
        text = json.dumps(value)
    except (ValueError, RecursionError):
        return "a value that cannot be shown"
    return text if len(text) <= _GIVEN_LENGTH else text[: _GIVEN_LENGTH - 3] + "..."
