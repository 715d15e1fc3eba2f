"""Claims about compile/together.py: which trees rays go through together, and the corners that triangles of a packet share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.together import FEW_NODES, packet_corners, together
from penumbra_kernels.hardcases.benches import geometry as kit
from penumbra_kernels.layout import CONSTANTS, PACKET8

QUAD = {"type": "quad", "origin": [0, 0, 0], "u": [1, 0, 0], "v": [0, 1, 0]}


def packets(corners: NDArray[np.float32], count: Any) -> NDArray[Any]:
    """PACKET8 of (p, 8, 3, 3) corners, of which the first `count` triangles are there."""
    out = np.zeros(len(corners), PACKET8)
    at = np.minimum(np.arange(8), np.asarray(count)[:, None] - 1)
    out["primitive"] = 8 * np.arange(len(corners))[:, None] + at
    kept = np.take_along_axis(corners, at[:, :, None, None], axis=1)
    for i, name in enumerate(("v0", "v1", "v2")):
        out[name] = kept[:, :, i].transpose(0, 2, 1)
    return out


def test_each_corner_of_each_triangle_stands_there_once_bit_for_bit() -> None:
    """Corners drawn from a few, so that most are shared; 0 and -0 are two."""
    rng = np.random.default_rng(1)
    pool = rng.choice(np.array([0.0, -0.0, 1.5, -2.25, 1e-42, 3e38], np.float32), (200, 5, 3))
    corners = np.take_along_axis(pool[:, :, None], rng.integers(0, 5, (200, 24))[..., None, None], axis=1)
    given = packets(corners.reshape(200, 8, 3, 3), rng.integers(1, 9, 200))
    for packet, record in zip(given, packet_corners(given), strict=True):
        count, there = int(record["triangles"]), record["corner"][: record["corners"]]
        assert count == len(set(packet["primitive"].tolist()))
        assert len({row.tobytes() for row in there}) == len(there)
        for i in range(8):
            for k in range(3):
                corner = there[record["index"][3 * i + k]]
                assert corner[:3].tobytes() == packet[f"v{k}"][:, i].tobytes()
                assert corner[3] == 0.0


def test_a_quad_has_four_corners_and_triangles_apart_have_all_of_theirs() -> None:
    assert kit.compiled([QUAD]).arrays["corners"]["corners"].tolist() == [4]
    rng = np.random.default_rng(2)
    apart = packets(rng.normal(size=(3, 8, 3, 3)).astype(np.float32), [8, 3, 1])
    assert packet_corners(apart)["corners"].tolist() == [24, 9, 3]


@pytest.mark.parametrize(("side", "small"), [(10, True), (60, False)])
def test_only_where_all_rays_go_together_are_corners_kept(side: int, small: bool) -> None:
    x, z = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0))
    a = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + 1, a + side + 1], 1), np.stack([a + 1, a + side + 2, a + side + 1], 1)]
    )
    arrays = kit.compiled_mesh(np.stack([x, np.sin(x * z), z], -1).reshape(-1, 3), faces).arrays
    assert (len(arrays["nodes"]) <= FEW_NODES) == small
    assert together(arrays) == (CONSTANTS["OPTION_TOGETHER"] if small else 0)
    assert len(arrays["corners"]) == (len(arrays["packets"]) if small else 0)
