"""Documents that tests of the contract start from."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture
def minimal() -> dict[str, Any]:
    """The smallest scene, with a shape of most kinds."""
    return {
        "version": 1,
        "camera": {"type": "perspective", "transform": {"translate": [0, 0, 5]}},
        "textures": {"board": {"type": "checker"}},
        "materials": {
            "wall": {"type": "diffuse", "base_color": {"texture": "board"}},
            "a/b~c": {"type": "mirror"},
        },
        "prototypes": {"ball": [{"type": "sphere"}]},
        "shapes": [
            {"type": "sphere", "material": "wall"},
            {"type": "instance", "prototype": "ball", "transform": [{"scale": 2}, {"translate": [1, 0, 0]}]},
            {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "indices": [[0, 1, 2]]},
            {"type": "quad", "emission": {"radiance": 3}},
        ],
        "lights": [{"type": "point"}],
        "environment": {"type": "constant"},
    }
