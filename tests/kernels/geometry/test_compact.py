"""The compact tree: its boxes hold the boxes they stand for, and it finds the wide tree's hits, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.accel.compact import compact_nodes, compact_triangles
from penumbra_kernels.layout import CONSTANTS, NODE8, PACKET8

EMPTY = CONSTANTS["LEAF_FLAG"]


def nodes_of(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """NODE8 of boxes (m, 8, 3)."""
    nodes = np.zeros(len(lo), NODE8)
    for axis, name in enumerate("xyz"):
        nodes[f"lo_{name}"], nodes[f"hi_{name}"] = lo[..., axis], hi[..., axis]
    return nodes


def device_planes(compact: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(m, 8) planes as the device computes them: exact products and sums in extended precision, rounded once."""
    axis = "xyz".index(name)
    exponent = (compact["exponents"] >> np.uint32(8 * axis)) & np.uint32(255)
    size = np.ldexp(np.longdouble(1.0), exponent.astype(int) - 127)[:, None]
    origin = compact["origin"][:, axis, None].astype(np.longdouble)
    with np.errstate(over="ignore"):
        return tuple(
            (compact[f"{side}_{name}"].astype(np.longdouble) * size + origin).astype(np.float32)
            for side in ("lo", "hi")
        )


@pytest.mark.parametrize("offset", [0.0, 1.0, 1e6, 3e30])
@pytest.mark.parametrize("size", [1e-40, 1e-20, 1e-3, 1.0, 1e5, 1e30])
def test_boxes_on_the_grid_hold_the_boxes(offset: float, size: float) -> None:
    rng = np.random.default_rng(7)
    center = offset + size * rng.normal(size=(500, 8, 3))
    half = size * np.exp(rng.uniform(-12, 1, (500, 8, 3))) * (rng.random((500, 8, 3)) < 0.9)
    nodes = nodes_of((center - half).astype(np.float32), (center + half).astype(np.float32))
    compact = compact_nodes(nodes)
    for name in "xyz":
        lo, hi = device_planes(compact, name)
        assert (lo <= nodes[f"lo_{name}"]).all()
        assert (hi >= nodes[f"hi_{name}"]).all()


def test_boxes_on_the_grid_are_no_larger_than_two_steps_more() -> None:
    rng = np.random.default_rng(8)
    lo = rng.random((200, 8, 3)).astype(np.float32)
    hi = (lo + rng.random((200, 8, 3))).astype(np.float32)
    compact = compact_nodes(nodes_of(lo, hi))
    for axis, name in enumerate("xyz"):
        low, high = device_planes(compact, name)
        step = 2.0 * (hi[..., axis].max(axis=1) - lo[..., axis].min(axis=1)) / 255
        assert (lo[..., axis] - low <= step[:, None] * 1.001).all()
        assert (high - hi[..., axis] <= step[:, None] * 1.001).all()


def test_empty_children_have_boxes_turned_inside_out() -> None:
    nodes = nodes_of(np.full((1, 8, 3), np.inf, np.float32), np.full((1, 8, 3), -np.inf, np.float32))
    nodes["child"] = EMPTY
    nodes["lo_x"][0, 0], nodes["hi_x"][0, 0], nodes["child"][0, 0] = 1.0, 2.0, 5
    for name in "yz":
        nodes[f"lo_{name}"][0, 0], nodes[f"hi_{name}"][0, 0] = 1.0, 2.0
    compact = compact_nodes(nodes)[0]
    assert compact["child"][0] == 5
    assert (compact["lo_x"][1:] > compact["hi_x"][1:]).all()


def test_the_last_lane_of_a_packet_is_marked() -> None:
    packets = np.zeros(2, PACKET8)
    packets["primitive"] = [[4, 5, 6, 6, 6, 6, 6, 6], [0, 1, 2, 3, 4, 5, 6, 7]]
    packets["v1"] = np.arange(48).reshape(2, 3, 8)
    triangles = compact_triangles(packets)
    assert np.argmax(triangles["last"][:8]) == 2
    assert np.argmax(triangles["last"][8:]) == 7
    assert triangles["v1"][9].tolist() == [25.0, 33.0, 41.0]


def soup(rng: np.random.Generator, n: int, size: float) -> dict[str, Any]:
    corners = rng.uniform(-1, 1, (n, 1, 3)) + size * rng.normal(size=(n, 3, 3))
    return {
        "type": "mesh",
        "positions": corners.reshape(-1, 3).tolist(),
        "indices": np.arange(3 * n).reshape(-1, 3).tolist(),
    }


def deforming(rng: np.random.Generator, n: int) -> dict[str, Any]:
    mesh = soup(rng, n, 0.2)
    moved = (np.array(mesh["positions"]) + 0.3 * rng.normal(size=(3 * n, 3))).tolist()
    return {
        **mesh,
        "deformation": [{"time": 0, "positions": mesh["positions"]}, {"time": 1, "positions": moved}],
    }


TURN = {
    "keyframes": [
        {"time": 0, "transform": [{"scale": [1, 0.5, 2]}]},
        {"time": 1, "transform": [{"scale": [1, 0.5, 2]}, {"rotate": {"axis": [0, 1, 1], "angle": 70}}]},
    ]
}

SLIDE = {"keyframes": [{"time": t, "transform": [{"translate": [2 * t, 0, -t]}]} for t in (0, 0.3, 1)]}


def shapes_of(kind: str, rng: np.random.Generator) -> list[dict[str, Any]]:
    if kind == "triangles":
        return [soup(rng, 3000, 0.1)]
    if kind == "needles":
        return [soup(rng, 500, 1e-4), soup(rng, 500, 2.0)]
    if kind == "round":
        spheres = [
            {"type": "sphere", "center": c, "radius": 0.1} for c in rng.uniform(-1, 1, (60, 3)).tolist()
        ]
        return [*spheres, {"type": "disc", "radius": 0.7}, soup(rng, 50, 0.3)]
    if kind == "moving":
        return [
            {**soup(rng, 200, 0.2), "transform": TURN},
            {**soup(rng, 200, 0.2), "transform": SLIDE},
            soup(rng, 300, 0.1),
        ]
    return [deforming(rng, 60), soup(rng, 100, 0.1)]


@pytest.fixture(scope="module")
def compact_probe(device: Any, kit: Any) -> Any:
    return kit.Probe(device, {**device.flags, "PENUMBRA_COMPACT_TREE": 1})


@pytest.fixture(scope="module")
def wide_probe(device: Any, kit: Any) -> Any:
    return kit.Probe(device, {**device.flags, "PENUMBRA_COMPACT_TREE": 0})


@pytest.mark.parametrize("kind", ["triangles", "needles", "round", "moving", "deforming"])
def test_both_trees_find_the_same_hits(kind: str, kit: Any, wide_probe: Any, compact_probe: Any) -> None:
    rng = np.random.default_rng(11)
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 1}}
    geometry = kit.compiled(shapes_of(kind, rng), camera=camera)
    n = 30_000
    origins = rng.uniform(-2, 2, (n, 3))
    directions = kit.directions(rng, n)
    directions[: n // 10, rng.integers(0, 3)] = 0.0
    rays = kit.rays(origins, directions, time=rng.random(n))
    rays[: n // 2, 6] = rng.uniform(0.1, 3, n // 2)
    wide, compact = wide_probe.trace(geometry, rays), compact_probe.trace(geometry, rays)
    assert (wide["kind"] != kit.NONE).sum() > n / 20
    for name in wide.dtype.names or ():
        np.testing.assert_array_equal(wide[name], compact[name], err_msg=name)
