"""What a document may hold at some place, in words, read off its JSON Schema."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

_MOST_WORDS: Final = 40


def accepted_at(schema: dict[str, Any], body: Any, path: Sequence[str | int], *, parent: bool = False) -> str:
    """What `schema` accepts at `path` of `body`; with `parent`, the keys of the object that holds it.

    "" where the schema says nothing about the place.
    """
    if not schema:
        return ""
    options = _options(schema, schema)
    steps = list(path[:-1] if parent else path)
    for key in steps:
        options = [found for option in _fitting(options, body) for found in _step(schema, option, key)]
        body = _child(body, key)
    if parent:
        return _keys(_fitting(options, body), None if not path else str(path[-1]))
    return _in_words(schema, options)


def _child(body: Any, key: str | int) -> Any:
    if isinstance(body, dict):
        return body.get(key)
    if isinstance(body, list) and isinstance(key, int) and key < len(body):
        return body[key]
    return None


def _options(root: dict[str, Any], node: dict[str, Any]) -> list[dict[str, Any]]:
    """The alternatives that a schema node stands for, references followed."""
    if "$ref" in node:
        name = str(node["$ref"]).rsplit("/", 1)[-1]
        return _options(root, root["$defs"][name])
    for word in ("oneOf", "anyOf", "allOf"):
        if word in node:
            return [option for part in node[word] for option in _options(root, part)]
    return [node]


def _fitting(options: list[dict[str, Any]], body: Any) -> list[dict[str, Any]]:
    """Of several alternatives those that `body` means to be: by JSON type, `type` word, or keys."""
    if isinstance(body, list):
        return [o for o in options if o.get("type") == "array"] or options
    if not isinstance(body, dict):
        return options
    objects = [o for o in options if o.get("type") == "object"]
    worded = [o for o in objects if "type" in body and _word(o) == body["type"]]
    if worded or len(objects) < 2:
        return worded or objects or options
    if any(_word(o) is not None for o in objects):
        return objects
    shared = [len(body.keys() & o.get("properties", {}).keys()) for o in objects]
    most = max(shared)
    return [o for o, n in zip(objects, shared, strict=True) if n == most]


def _word(option: dict[str, Any]) -> Any:
    return option.get("properties", {}).get("type", {}).get("const")


def _step(root: dict[str, Any], option: dict[str, Any], key: str | int) -> list[dict[str, Any]]:
    """The alternatives at `key` of an object or array."""
    if isinstance(key, int):
        prefix = option.get("prefixItems", [])
        found = prefix[key] if key < len(prefix) else option.get("items")
    else:
        found = option.get("properties", {}).get(key)
        if found is None:
            found = next(
                iter(option.get("patternProperties", {}).values()), option.get("additionalProperties")
            )
    return _options(root, found) if isinstance(found, dict) else []


def _in_words(root: dict[str, Any], options: list[dict[str, Any]]) -> str:
    words = [
        str(o["const"]) if not isinstance(o["const"], str) else f'"{o["const"]}"'
        for o in options
        if "const" in o
    ]
    parts = [" | ".join(dict.fromkeys(words))] if words else []
    parts += [text for o in options if "const" not in o and (text := _describe(root, o))]
    return " or ".join(dict.fromkeys(parts))


def _describe(root: dict[str, Any], option: dict[str, Any]) -> str:
    if "enum" in option:
        return " | ".join(f'"{v}"' if isinstance(v, str) else str(v) for v in option["enum"])
    kind = option.get("type")
    if kind in ("number", "integer"):
        return _number(option)
    if kind == "string":
        return _string(option)
    if kind == "array":
        return _array(root, option)
    if kind == "object":
        return _object(option)
    return {"boolean": "true | false", "null": "null"}.get(str(kind), "")


def _number(option: dict[str, Any]) -> str:
    option = _tightest(option)
    bounds = [
        f"{word} {_plain(option[key])}"
        for key, word in (
            ("exclusiveMinimum", "above"),
            ("minimum", "at least"),
            ("exclusiveMaximum", "below"),
            ("maximum", "at most"),
        )
        if key in option
    ]
    name = "a whole number" if option["type"] == "integer" else "a number"
    return name + (" " + ", ".join(bounds) if bounds else "")


def _tightest(option: dict[str, Any]) -> dict[str, Any]:
    """Of an inclusive and an exclusive bound on one side only the one that tells."""
    low, above = option.get("minimum", -math.inf), option.get("exclusiveMinimum", -math.inf)
    high, below = option.get("maximum", math.inf), option.get("exclusiveMaximum", math.inf)
    idle = {
        "minimum" if above >= low else "exclusiveMinimum",
        "maximum" if below <= high else "exclusiveMaximum",
    }
    return {key: value for key, value in option.items() if key not in idle}


def _plain(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:.16g}"


def _string(option: dict[str, Any]) -> str:
    least, most = option.get("minLength"), option.get("maxLength")
    text = "a string"
    if most is not None:
        text += f" of {least} to {most} characters" if least else f" of at most {most} characters"
    if "\\x00" in option.get("pattern", ""):
        text += ", none of them a control character"
    elif "pattern" in option:
        text += f" matching {option['pattern']}"
    return text


def _array(root: dict[str, Any], option: dict[str, Any]) -> str:
    prefix = option.get("prefixItems")
    if prefix:
        item = _in_words(root, _options(root, prefix[0]))
        return f"an array of {len(prefix)}, each {item}" if item else f"an array of {len(prefix)}"
    least, most = option.get("minItems"), option.get("maxItems")
    bounds = [f"at least {least}"] * (least is not None) + [f"at most {most}"] * (most is not None)
    return "an array" + (" of " + " and ".join(bounds) if bounds else "")


def _object(option: dict[str, Any]) -> str:
    word = _word(option)
    if word is not None:
        return f'{{"type": "{word}", ...}}'
    keys = list(option.get("properties", {}))
    if not keys:
        return "an object"
    if len(keys) == 1:
        return f'{{"{keys[0]}": ...}}'
    return "an object with the keys " + ", ".join(keys[:_MOST_WORDS])


def _keys(options: list[dict[str, Any]], wrong: str | None) -> str:
    """The keys that an object may have, the likeliest meant one first."""
    from difflib import get_close_matches

    keys = list(dict.fromkeys(key for option in options for key in option.get("properties", {})))
    if not keys:
        return ""
    close = get_close_matches(wrong, keys, 1) if wrong else []
    hint = [f"{close[0]} (did you mean this?)"] if close else []
    return "the keys " + ", ".join(hint + [key for key in keys[:_MOST_WORDS] if key not in close])
