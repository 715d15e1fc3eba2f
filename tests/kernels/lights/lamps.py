"""Every kind of light, and transforms to put them under."""

from __future__ import annotations

from typing import Any

GLOW = {"radiance": [2.0, 1.0, 0.0]}

SHAPES: list[dict[str, Any]] = [
    {"type": "sphere", "center": [0, 5, 0], "radius": 0.5},
    {"type": "quad", "origin": [-1, 3, -1], "u": [1, 0, 0], "v": [0, 0, 1], "emission": GLOW},
    {
        "type": "disc",
        "center": [3, 2, 0],
        "normal": [-1, 0, 0],
        "radius": 0.7,
        "emission": {**GLOW, "two_sided": True},
    },
    {"type": "sphere", "center": [0, 2, 3], "radius": 0.4, "emission": GLOW},
    {
        "type": "mesh",
        "positions": [[-3, 1, 0], [-3, 2, 0], [-3, 1, 1], [-3, 2, 2]],
        "indices": [[0, 1, 2], [1, 3, 2]],
        "emission": GLOW,
    },
]
LIGHTS: list[dict[str, Any]] = [
    {"type": "point", "position": [0, 4, 0], "intensity": 3},
    {"type": "spot", "position": [1, 4, 0], "direction": [0, -2, 0], "intensity": 6, "outer_cone_angle": 60},
    {"type": "directional", "direction": [0, -3, 4], "irradiance": 0.5},
]

STRETCH: list[dict[str, Any]] = [{"scale": [1.0, 0.4, 1.5]}, {"rotate": {"axis": [1, 1, 0], "angle": 25}}]
MOVE: dict[str, Any] = {
    "keyframes": [
        {"time": 0, "transform": [{"rotate": {"axis": [0, 0, 1], "angle": 0}}]},
        {"time": 1, "transform": [{"rotate": {"axis": [0, 0, 1], "angle": 60}}, {"translate": [0, 1, 0]}]},
    ]
}
