"""The page /docs: every route with its parameters, answers and an example, from the OpenAPI document.
Works offline."""

from __future__ import annotations

import json
from typing import Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from jinja2 import Environment

router = APIRouter(include_in_schema=False)

_TEMPLATE: Final = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string("""\
<!doctype html> <html lang="en"> <meta charset="utf-8"> <meta name="viewport"
content="width=device-width"> <title>{{ info.title }} {{ info.version }}: REST API</title> <style> body {
font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222;
background: #fff } @media (prefers-color-scheme: dark) { body { color: #ddd; background: #181818 } a {
color: #8cf } } code, pre { font: 14px/1.4 ui-monospace, monospace } pre { overflow: auto; padding: .7rem;
border: 1px solid #8886; border-radius: 4px } h2 { margin-top: 2.5rem; text-transform: capitalize } h3 {
margin: 1.8rem 0 .3rem } table { border-collapse: collapse } td, th { padding: .1rem 1rem .1rem 0;
text-align: left; vertical-align: top } </style> <h1>{{ info.title }} {{ info.version }}</h1> <p>{{
info.description }}</p> <p>For programs: <a href="/openapi.json">OpenAPI</a>, JSON Schema of {% for name
in ("scene", "job", "receipt") %}<a href="/v1/schema/{{ name }}">{{ name }}</a>{{ ", " if not loop.last }}
{% endfor %}. With an API key, send the header <code>Authorization: Bearer &lt;key&gt;</code>.</p> {% for
tag, routes in groups.items() %} <h2 id="{{ tag }}">{{ tag }}</h2> {% for route in routes %} <h3 id="{{
route.id }}"><code>{{ route.method }} {{ route.path }}</code></h3> <p>{{ route.description }}</p> {% if
route.parameters %} <table><tr><th>parameter<th>in<th>meaning</tr> {% for p in route.parameters
%}<tr><td><code>{{ p.name }}</code>{{ " (required)" if p.required }}<td>{{ p.in }} <td>{{ p.description or
p.schema.description }}{% endfor %}</table> {% endif %} {% for name, example in route.examples %}
<details><summary>Example: {{ name }}</summary><pre>{{ example }}</pre></details> {% endfor %} <p>Answers:
{% for code, words in route.answers %}{{ code }} ({{ words }}){{ ", " if not loop.last }}{% endfor %}</p>
{% endfor %}{% endfor %} """)


@router.get("/docs")
def reference(request: Request) -> HTMLResponse:
    """The REST API, for people."""
    schema = request.app.openapi()
    return HTMLResponse(_TEMPLATE.render(info=schema["info"], groups=_groups(schema)))


def _groups(schema: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
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
