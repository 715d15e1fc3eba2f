"""From boxes to the device's tree: NODE8 nodes, and which items stand in which packet.

Leaf words are LEAF_* of layout.py. The traversal's stack is a fixed array on the device: MAX_STACK is what
any tree may need of it at most, and trees that would need more are built again with halving instead of the
heuristic further down.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.accel import wide
from penumbra_kernels.accel.binary import SWEEP_LIMIT, BinaryTree, Boxes, build_binary, compiled
from penumbra_kernels.layout import CONSTANTS, NODE8

ALONE: Final = -1
"""Key of items that are a leaf of their own, under their own word."""
STATIC: Final = 0
"""Key of triangles that stand still; keys above are deforming meshes, one each."""
MAX_STACK: Final = 95
"""Entries; cl/geometry/traverse.cl reserves as many for each level."""
SAH_DEPTHS: Final = (64, 40, 24, 12, 0)
EMPTY_WORD: Final = CONSTANTS["LEAF_FLAG"]
_HEADER: Final = struct.Struct("<QQQQ")  # nodes, packets, root, stack


class TreeError(ValueError):
    """The geometry does not fit the tree's words; the message says which limit."""


@dataclass(frozen=True)
class Items:
    """What a tree is built over; n of them."""

    lo: Boxes
    """(n, 3) float32, bounds."""
    hi: Boxes
    key: NDArray[np.int32]
    """(n,): ALONE, STATIC, or 1 + the number of a deforming mesh."""
    word: NDArray[np.uint32]
    """(n,): leaf words of those that are ALONE."""


@dataclass(frozen=True)
class Tree:
    """A tree, ready but for the vertices in its packets."""

    nodes: NDArray[Any]
    """(m,) of NODE8."""
    root: int
    """Child word."""
    packet_items: NDArray[np.int32]
    """(p, 8): which item stands in each lane; short packets repeat their last."""
    packet_keyframe: NDArray[np.int32]
    """(p,): which deformation keyframe."""
    stack: int
    """Entries that a traversal needs at most."""

    @property
    def bytes(self) -> int:
        """Memory of its arrays."""
        return self.nodes.nbytes + self.packet_items.nbytes + self.packet_keyframe.nbytes

    def moved(self, node_base: int, packet_base: int) -> Tree:
        """The same tree behind so many nodes and packets of other trees in the arrays that they share."""
        if packet_base + len(self.packet_items) > CONSTANTS["LEAF_PACKET_MASK"]:
            raise TreeError(f"more than {CONSTANTS['LEAF_PACKET_MASK']} packets of triangles")
        if not node_base and not packet_base:
            return self
        nodes = self.nodes.copy()
        nodes["child"] = _moved_words(nodes["child"], node_base, packet_base)
        root = int(_moved_words(np.array([self.root], np.uint32), node_base, packet_base)[0])
        return replace(self, nodes=nodes, root=root)

    def grafted(self, word: int, root: int) -> Tree:
        """With the leaf `word`, one of several, replaced by another tree's root. The stack stays this tree's own: whoever
        grafts sees to it that both fit."""
        nodes = self.nodes.copy()
        nodes["child"][nodes["child"] == word] = root
        return replace(self, nodes=nodes)


def _moved_words(words: NDArray[np.uint32], node_base: int, packet_base: int) -> NDArray[np.uint32]:
    """Child words with the two numbers added to whatever they index."""
    kind = (words >> np.uint32(CONSTANTS["LEAF_TYPE_SHIFT"])) & np.uint32(3)
    count = (words >> np.uint32(CONSTANTS["LEAF_COUNT_SHIFT"])) & np.uint32(3)
    inner = words < EMPTY_WORD
    triangles = (kind == CONSTANTS["LEAF_TRIANGLES"]) & (count > 0)
    packets = ~inner & (triangles | (kind == CONSTANTS["LEAF_DEFORMING"]))
    shift = np.where(inner, np.uint32(node_base), np.where(packets, np.uint32(packet_base), np.uint32(0)))
    return np.asarray(words + shift, np.uint32)


def round_word(kind: int, index: int) -> int:
    """Leaf word of a sphere (kind 0) or disc (kind 1)."""
    if index > CONSTANTS["LEAF_ROUND_MASK"]:
        raise TreeError(f"more than {CONSTANTS['LEAF_ROUND_MASK'] + 1} spheres or discs")
    return (
        EMPTY_WORD
        | CONSTANTS["LEAF_ROUND"] << CONSTANTS["LEAF_TYPE_SHIFT"]
        | kind << CONSTANTS["LEAF_DISC_SHIFT"]
        | index
    )


def instance_word(index: int) -> int:
    """Leaf word of an instance."""
    if index > CONSTANTS["LEAF_INSTANCE_MASK"]:
        raise TreeError(f"more than {CONSTANTS['LEAF_INSTANCE_MASK'] + 1} instances")
    return EMPTY_WORD | CONSTANTS["LEAF_INSTANCE"] << CONSTANTS["LEAF_TYPE_SHIFT"] | index


def boxes_only(lo: Boxes, hi: Boxes, word: int) -> Tree:
    """A node that no tree leads to, for its eight boxes (8, 3) alone; the same word under each."""
    node = np.zeros(1, NODE8)
    for axis, name in enumerate("xyz"):
        node[f"lo_{name}"], node[f"hi_{name}"] = lo[:, axis], hi[:, axis]
    node["child"] = word
    return Tree(node, word, np.zeros((0, 8), np.int32), np.zeros(0, np.int32), 0)


def tree_to_bytes(tree: Tree) -> bytes:
    """For files."""
    header = _HEADER.pack(len(tree.nodes), len(tree.packet_items), tree.root, tree.stack)
    return b"".join(
        (header, tree.nodes.tobytes(), tree.packet_items.tobytes(), tree.packet_keyframe.tobytes())
    )


def tree_from_bytes(data: bytes) -> Tree:
    """What tree_to_bytes was given; its arrays are views of the data."""
    nodes, packets, root, stack = _HEADER.unpack_from(data)
    at = _HEADER.size
    node = np.frombuffer(data, NODE8, nodes, at)
    at += node.nbytes
    items = np.frombuffer(data, np.int32, 8 * packets, at).reshape(packets, 8)
    at += items.nbytes
    return Tree(node, root, items, np.frombuffer(data, np.int32, packets, at), stack)


def build_tree(
    items: Items,
    copies: NDArray[np.int64] | None = None,
    sweep_limit: int = SWEEP_LIMIT,
) -> Tree:
    """Build over the items; the words count from this tree's own first node and packet.

    copies: by key, how many packets a group of its triangles takes (deformation keyframes); [1] where none
    deforms.
    """
    copies = np.ones(1, np.int64) if copies is None else copies
    n = len(items.lo)
    if n == 0:
        return Tree(np.zeros(0, NODE8), EMPTY_WORD, np.zeros((0, 8), np.int32), np.zeros(0, np.int32), 0)
    if n == 1:
        return _single(items, copies)
    for depth in SAH_DEPTHS:
        tree = _collapse(
            items,
            build_binary(items.lo, items.hi, depth, sweep_limit),
            copies,
            n <= sweep_limit,
        )
        if tree.stack <= MAX_STACK:
            return tree
    raise TreeError(f"a tree over {n} items needs a deeper stack than {MAX_STACK}")


def _leaf(key: int, packets: int) -> int:
    return wide.DEFORMING if key > 0 else EMPTY_WORD | packets << CONSTANTS["LEAF_COUNT_SHIFT"]


def _packets(order: NDArray[np.int32], key: int, copies: NDArray[np.int64]) -> Tree:
    """A tree that is one leaf of triangles."""
    rows = int(copies[key]) if key > 0 else -(-len(order) // 8)
    lanes = np.arange(8)[None, :] + (0 if key > 0 else 8 * np.arange(rows)[:, None])
    lanes = np.broadcast_to(np.minimum(lanes, len(order) - 1), (rows, 8))
    keyframe = np.arange(rows, dtype=np.int32) if key > 0 else np.zeros(rows, np.int32)
    return Tree(np.zeros(0, NODE8), _leaf(key, rows), order[lanes], keyframe, 0)


def _single(items: Items, copies: NDArray[np.int64]) -> Tree:
    key = int(items.key[0])
    if key == ALONE:
        return Tree(
            np.zeros(0, NODE8), int(items.word[0]), np.zeros((0, 8), np.int32), np.zeros(0, np.int32), 0
        )
    return _packets(np.zeros(1, np.int32), key, copies)


def _functions(plain: bool) -> tuple[Callable[..., Any], ...]:
    functions = (wide.plan, wide.spread, wide.write)
    return functions if plain else tuple(compiled(f) for f in functions)


def _item_costs(items: Items, order: NDArray[np.int32]) -> NDArray[np.float32]:
    """Cost of each item as a child of its own, by position."""
    d = items.hi - items.lo
    area = d[:, 0] * d[:, 1] + d[:, 1] * d[:, 2] + d[:, 2] * d[:, 0]
    return np.asarray((area * np.float32(wide.PACKET_COST))[order], np.float32)


def _collapse(items: Items, tree: BinaryTree, copies: NDArray[np.int64], plain: bool) -> Tree:
    plan, spread, write = _functions(plain)
    m = len(tree.child)
    cost, share = np.empty((m, 7), np.float32), np.empty((m, 7), np.int8)
    split8, is_leaf, key = np.empty(m, np.int8), np.empty(m, np.int8), np.empty(m, np.int32)
    item_key, item_cost = items.key[tree.order], _item_costs(items, tree.order)
    plan(tree.child, tree.lo, tree.hi, tree.count, item_cost, item_key, cost, share, split8, is_leaf, key)
    del cost, item_cost
    if is_leaf[0]:
        return _packets(tree.order, int(key[0]), copies)
    # Upper bounds: pages that are never written are never taken from memory.
    table, first_child = np.empty((m, 8), np.int32), np.empty(m, np.int32)
    slots, packets = spread(
        tree.child, tree.count, item_key, copies, share, split8, is_leaf, key, table, first_child
    )
    if packets > CONSTANTS["LEAF_PACKET_MASK"]:
        raise TreeError(f"more than {CONSTANTS['LEAF_PACKET_MASK']} packets of triangles")
    nodes = np.empty(slots, NODE8)
    flat = nodes.view(np.float32).reshape(slots, wide.UINTS)
    positions, keyframe = np.empty((packets, 8), np.int32), np.empty(packets, np.int32)
    stack = write(
        table, first_child, tree.lo, tree.hi, tree.first, tree.count, items.lo, items.hi, tree.order,
        item_key, items.word, copies, is_leaf, key, flat, flat.view(np.uint32),
        positions, keyframe, np.zeros(slots, np.int64),
    )  # fmt: skip
    return Tree(nodes, 0, tree.order[positions], keyframe, int(stack))
