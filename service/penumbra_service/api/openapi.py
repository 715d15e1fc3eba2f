"""What OpenAPI says beyond the routes' own types: bodies that are parsed by hand, an example, the key."""

from __future__ import annotations

from typing import Any, Final

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from penumbra_scene.errors import MEDIA_TYPE
from penumbra_scene.job import JobChange, JobRequest

_REFS: Final = "#/components/schemas/{model}"

EXAMPLE_SCENE: Final[dict[str, Any]] = {
    "version": 1,
    "name": "a ball under a lamp",
    "camera": {
        "type": "perspective",
        "fov": 40,
        "transform": [{"look_at": {"origin": [0, 1.2, 5], "target": [0, 0.8, 0], "up": [0, 1, 0]}}],
    },
    "film": {"width": 320, "height": 240},
    "stop": {"relative_error": 0.05, "seconds": 60},
    "materials": {"clay": {"type": "diffuse", "base_color": [0.7, 0.5, 0.4]}},
    "shapes": [
        {"type": "plane", "material": "clay"},
        {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.8, "material": "clay"},
        {"type": "quad", "origin": [-1, 4, -1], "u": [2, 0, 0], "v": [0, 0, 2], "emission": {"radiance": 12}},
    ],
}
"""Renders as it stands."""

JOB_BODY: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {
                    "anyOf": [
                        {"$ref": _REFS.format(model="JobRequest")},
                        {"$ref": _REFS.format(model="Scene")},
                    ]
                },
                "examples": {
                    "job": {"summary": "A job", "value": {"scene": EXAMPLE_SCENE, "priority": 0}},
                    "scene": {"summary": "Just a scene", "value": EXAMPLE_SCENE},
                },
            }
        },
    }
}

_CERTAIN: Final = {"confidence": 0.95}
QUOTE_ANSWER: Final[dict[str, Any]] = {
    "description": "The quote",
    "content": {
        "application/json": {
            "example": {
                "schema_version": 1,
                "name": EXAMPLE_SCENE["name"],
                "scene_hash": "sha256:" + "5e" * 32,
                "picture_hash": "sha256:" + "1c" * 32,
                "stop": {"relative_error": 0.05, "seconds": 60, "confidence": 0.95},
                "sampler": "sobol",
                "replicates": 8,
                "table": [
                    {
                        "relative_error": 0.05,
                        "samples": 96,
                        "samples_interval": {"low": 64, "high": 128, **_CERTAIN},
                        "seconds": 1.9,
                        "seconds_interval": {"low": 1.2, "high": 2.6, **_CERTAIN},
                    }
                ],
                "end": {
                    "reason": "relative_error",
                    "samples": 96,
                    "samples_interval": {"low": 64, "high": 128, **_CERTAIN},
                    "seconds": 1.9,
                    "seconds_interval": {"low": 1.2, "high": 2.6, **_CERTAIN},
                    "relative_error": 0.047,
                    "relative_error_interval": {"low": 0.042, "high": 0.052, **_CERTAIN},
                },
                "theta": 1.12,
                "theta_interval": [1.02, 1.22],
                "seconds_per_sample": 0.0198,
                "compile": {"seconds": 4.1, "warm": False},
                "build": {"seconds": 0.05, "warm": False},
                "pilot": {
                    "pixels": 32000,
                    "blocks": 125,
                    "blocks_in_picture": 300,
                    "samples": 128,
                    "seconds": 1.8,
                },
            }
        }
    },
}

CHANGE_BODY: Final[dict[str, Any]] = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": JobChange.model_json_schema()}},
    }
}
_REFUSED: Final = {
    "401": "The service needs an API key",
    "403": "Not under this name, or not from this page",
    "404": "There is no such thing, or not yet",
    "413": "The body is too long",
    "415": "The body is of another media type",
    "416": "The range lies outside",
    "422": "Something in the request is not valid; `errors` says what",
}


def install(app: FastAPI) -> None:
    """Has the application describe itself with these additions."""

    def describe() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _described(app)
        return app.openapi_schema

    app.openapi = describe  # type: ignore[method-assign]


def _described(app: FastAPI) -> dict[str, Any]:
    schema = get_openapi(
        title=app.title,
        version=app.version,
        description=app.description,
        routes=app.routes,
        tags=app.openapi_tags,
    )
    components = schema.setdefault("components", {})
    request = JobRequest.model_json_schema(ref_template=_REFS)
    models = {**request.pop("$defs"), "JobRequest": request}
    components["schemas"] = {**models, **components.get("schemas", {})}
    components["securitySchemes"] = {"apiKey": {"type": "http", "scheme": "bearer"}}
    schema["security"] = [{}, {"apiKey": []}]
    _add_refusals(schema["paths"])
    return schema


def _add_refusals(paths: dict[str, Any]) -> None:
    """Answers that come from before or behind the routes: every one is a Problem."""
    content = {MEDIA_TYPE: {"schema": {"$ref": _REFS.format(model="Problem")}}}
    for path, operations in paths.items():
        for method, operation in operations.items():
            for status in _refusals(path, method, operation["responses"]):
                described = operation["responses"].get(status, {}).get("description", _REFUSED[status])
                operation["responses"][status] = {"description": described, "content": content}


def _refusals(path: str, method: str, known: dict[str, Any]) -> set[str]:
    found = {"403", *({"422"} & known.keys())}
    if not path.startswith("/health"):
        found.add("401")
    if "{" in path and method == "get":
        found.add("404")
    if path.endswith((".exr", ".png", "receipt.json", "/content")):
        found.add("416")
    if path.startswith("/v1/assets") and method in ("post", "put"):
        found |= {"413", "415", "422"}
    return found
