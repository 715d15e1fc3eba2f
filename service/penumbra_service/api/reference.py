"""What the page /docs shows: every route with its parameters, answers and an example, from the OpenAPI document."""

from __future__ import annotations

import json
import re
from typing import Any, Final

from markupsafe import Markup, escape

_CODE: Final = re.compile("`([^`]+)`")
"""Descriptions are Markdown, of which they use this much."""


def in_html(text: str) -> Markup:
    """A description: what stands in backticks becomes code, all else is escaped."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))


def routes_by_tag(schema: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Each tag's routes, in the document's order."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for path, methods in schema["paths"].items():
        for method, route in methods.items():
            if method != "head":
                tag = (route.get("tags") or ["other"])[0]
                groups.setdefault(tag, []).append(_route(path, method, route))
    return groups


def _route(path: str, method: str, route: dict[str, Any]) -> dict[str, Any]:
    body = route.get("requestBody", {}).get("content", {}).get("application/json", {})
    return {
        "id": f"{method}-{path}",
        "method": method.upper(),
        "path": path,
        "description": route.get("description", ""),
        "parameters": route.get("parameters", []),
        "examples": [
            (example["summary"], json.dumps(example["value"], indent=1))
            for example in body.get("examples", {}).values()
        ],
        "answers": [(code, answer["description"]) for code, answer in sorted(route["responses"].items())],
    }
