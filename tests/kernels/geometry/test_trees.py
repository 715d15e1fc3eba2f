"""The trees themselves: everything in them once and inside its boxes; shallow enough; no numba when small."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.accel.build import ALONE, MAX_STACK, STATIC, Items, Tree, build_tree
from penumbra_kernels.layout import CONSTANTS

LEAF = CONSTANTS["LEAF_FLAG"]


def _items(lo: Any, hi: Any, key: Any = STATIC) -> Items:
    n = len(lo)
    word = LEAF | 2 << 29 | np.arange(n)  # as instances
    return Items(
        np.asarray(lo, np.float32),
        np.asarray(hi, np.float32),
        np.broadcast_to(np.asarray(key, np.int32), (n,)).copy(),
        word.astype(np.uint32),
    )


def _walk(tree: Tree, items: Items) -> tuple[list[int], int]:
    """Items met below the root, each checked to be inside the boxes above it, and the deepest stack."""
    seen: list[int] = []

    def leaf(word: int, lo: Any, hi: Any) -> None:
        kind = (word >> 29) & 3
        if kind == 0:
            first, count = word & (1 << 27) - 1, (word >> 27) & 3
            found = {int(i) for i in tree.packet_items[first : first + count].ravel()}
        elif kind == 3:
            found = {int(i) for i in tree.packet_items[word & (1 << 27) - 1]}
        else:
            found = {word & (1 << 29) - 1}
        for i in found:
            assert (items.lo[i] >= lo).all()
            assert (items.hi[i] <= hi).all()
        seen.extend(found)

    def node(word: int, lo: Any, hi: Any) -> int:
        if word & LEAF:
            leaf(word, lo, hi)
            return 0
        record = tree.nodes[word]
        empty = record["child"] == LEAF
        assert np.all(empty[:-1] <= empty[1:])  # those that are there come first
        below, used = 0, 0
        for j in range(8):
            child = int(record["child"][j])
            if child == LEAF:
                continue
            used += 1
            a = np.array([record[f"lo_{x}"][j] for x in "xyz"])
            b = np.array([record[f"hi_{x}"][j] for x in "xyz"])
            assert (a >= lo).all()
            assert (b <= hi).all()
            below = max(below, node(child, a, b))
        return used - 1 + below

    depth = node(tree.root, np.full(3, -np.inf), np.full(3, np.inf))
    return sorted(seen), depth


def _inputs(name: str) -> tuple[Any, Any]:
    rng = np.random.default_rng(1)
    n = 3000
    c = rng.uniform(-1, 1, (n, 3))
    if name == "scattered":
        return c, c + rng.uniform(0, 0.1, (n, 3))
    if name == "coincident":
        return np.zeros((n, 3)), np.ones((n, 3))
    if name == "points":
        return np.zeros((n, 3)), np.zeros((n, 3))
    if name == "nested":
        size = np.exp2(np.linspace(-60, 60, n))[:, None] * np.ones(3)
        return -size, size
    if name == "receding":
        size = np.exp2(np.linspace(-60, 60, n))[:, None] * np.ones(3)
        return size, size * 1.001
    return np.sort(c, axis=0) * [1, 0, 0], np.sort(c, axis=0) * [1, 0, 0]


@pytest.mark.parametrize("name", ["scattered", "coincident", "points", "nested", "receding", "line"])
@pytest.mark.parametrize("count", [1, 2, 9, 700, 3000])
@pytest.mark.parametrize("sweep_limit", [4000, 0])
def test_every_item_is_in_the_tree_once_and_inside_its_boxes(name: str, count: int, sweep_limit: int) -> None:
    if sweep_limit and count > 700:
        pytest.skip("large inputs are binned")
    lo, hi = _inputs(name)
    pick = np.linspace(0, 2999, count).astype(int)
    items = _items(lo[pick], hi[pick])
    tree = build_tree(items, sweep_limit=sweep_limit)
    seen, depth = _walk(tree, items)
    assert seen == list(range(count))
    assert depth <= tree.stack <= MAX_STACK


def test_packets_hold_only_triangles_of_one_kind() -> None:
    lo, hi = _inputs("scattered")
    rng = np.random.default_rng(2)
    items = _items(lo[:500], hi[:500], rng.integers(ALONE, 3, 500))
    tree = build_tree(items, np.array([1, 3, 5]))
    seen, _ = _walk(tree, items)
    assert seen == list(range(500))
    for row, keyframe in zip(tree.packet_items, tree.packet_keyframe, strict=True):
        assert len(set(items.key[row])) == 1
        assert items.key[row[0]] != ALONE
        assert keyframe < (1, 3, 5)[items.key[row[0]]]


def test_trees_are_the_same_every_time() -> None:
    lo, hi = _inputs("scattered")
    for limit in (4000, 0):
        a, b = (build_tree(_items(lo[:900], hi[:900]), sweep_limit=limit) for _ in range(2))
        assert a.nodes.tobytes() == b.nodes.tobytes()
        assert a.packet_items.tobytes() == b.packet_items.tobytes()


def test_a_small_scene_is_built_without_numba() -> None:
    code = (
        "import sys, numpy as np; from penumbra_kernels.accel.build import *;"
        "lo = np.random.default_rng(0).random((500, 3), np.float32);"
        "build_tree(Items(lo, lo + 1, np.zeros(500, np.int32), np.zeros(500, np.uint32)));"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
