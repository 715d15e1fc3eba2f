"""A scene as a whole made larger, turned and moved, camera and all: the same picture."""

from __future__ import annotations

import copy
from typing import Any

Document = dict[str, Any]


def transformed(
    document: Document,
    *,
    scale: float = 1.0,
    rotate: Document | None = None,
    move: tuple[float, float, float] = (0, 0, 0),
) -> Document:
    """The scene (in JSON) scaled about the origin, then turned by `rotate` ({"axis", "angle"}), then moved by metres.

    Radiance stays: intensities of lights without a body go with the square of the scale.
    """
    steps: list[Document] = [{"scale": scale}] if scale != 1.0 else []
    turn: list[Document] = [{"rotate": rotate}] if rotate is not None else []
    steps += [*turn, {"translate": list(move)}]
    scene = copy.deepcopy(document)
    for thing in (scene["camera"], *scene.get("shapes", ()), *scene.get("lights", ())):
        thing["transform"] = _followed(thing.get("transform", []), steps)
    for light in scene.get("lights", ()):
        if light["type"] != "directional":
            light["intensity"] = _times(light.get("intensity", 1.0), scale**2)
    _scale_camera(scene["camera"], scale)
    environment = scene.get("environment") or {}
    if environment.get("type") == "image" and turn:
        environment["transform"] = _followed(environment.get("transform", []), turn)
    return scene


def _followed(transform: Any, steps: list[Document]) -> Any:
    """The transform, and then the steps."""
    if isinstance(transform, dict) and "keyframes" in transform:
        keys = [{**key, "transform": _followed(key["transform"], steps)} for key in transform["keyframes"]]
        return {"keyframes": keys}
    return [*([transform] if isinstance(transform, dict) else transform), *steps]


def _scale_camera(camera: Document, scale: float) -> None:
    if camera["type"] == "orthographic":
        camera["height"] = camera.get("height", 2.0) * scale
    lens = camera.get("lens")
    if lens is not None:
        lens["aperture_radius"] = lens.get("aperture_radius", 0.0) * scale
        lens["focus_distance"] = lens.get("focus_distance", 1.0) * scale


def _times(value: Any, factor: float) -> Any:
    return [x * factor for x in value] if isinstance(value, (list, tuple)) else value * factor
