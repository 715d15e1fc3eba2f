"""A program without an effect computes the same bits as one with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

CASES: list[tuple[dict[str, Any], int, int]] = [
    # material, whether it needs gloss, whether it needs transmission
    ({"type": "diffuse", "base_color": (0.2, 0.5, 0.7)}, 0, 0),
    ({"type": "phong"}, 1, 0),
    ({"type": "mirror", "color": 0.9}, 1, 0),
    ({"type": "conductor", "roughness": 0.3, "anisotropy": 0.4, "rotation": 10}, 1, 0),
    ({"type": "plastic", "roughness": 0.2}, 1, 0),
    ({"type": "dielectric", "roughness": 0.0}, 1, 1),
    ({"type": "dielectric", "roughness": 0.4}, 1, 1),
    ({"type": "thin_dielectric", "roughness": 0.2}, 1, 1),
    ({"type": "diffuse_transmission"}, 0, 1),
]
FRAME = ((0.0, 0.6, 0.8), (0.0, 0.352, 0.936), (0.6, -0.7488, 0.2816))


@pytest.mark.parametrize(("material", "gloss", "transmission"), CASES)
def test_specialised_and_generic_programs_agree_bit_for_bit(
    bench_with: Callable[[int, int, int], Any], material: dict[str, Any], gloss: int, transmission: int
) -> None:
    generic = bench_with(1, 1, 1)
    wo, wi, u = generic.directions(20_000, 1), generic.directions(20_000, 2), generic.uniforms(20_000, 3)
    value, pdf = generic.evaluate(material, wo, wi, FRAME)
    s = generic.sample(material, wo, u, FRAME)
    albedo, smooth = generic.describe(material, wo, FRAME)
    assert s.alive.any()
    special = bench_with(gloss, transmission, 0)
    other = special.sample(material, wo, u, FRAME)
    results = [*special.evaluate(material, wo, wi, FRAME), other.wi, other.weight, other.pdf, other.event]
    results += special.describe(material, wo, FRAME)
    for a, b in zip([value, pdf, s.wi, s.weight, s.pdf, s.event, albedo, smooth], results, strict=True):
        assert np.array_equal(a.view(np.uint32), b.view(np.uint32))
