"""What OpenAPI says beyond the routes' own types: bodies that are parsed by hand, an example, the key."""

from __future__ import annotations

from typing import Any, Final

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from penumbra_scene.job import JobRequest

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
    return schema
