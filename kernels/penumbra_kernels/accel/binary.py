"""Binary trees over boxes by the surface area heuristic, down to single items.

Two builders with one result type: a full sweep in numpy for small inputs (no compiler to wait for), and binning, compiled
by numba, for large ones. Both are deterministic: equal costs go to the most even split, equal positions to the lower
item. Any tree gives the same hits, so which of them ran does not show in a picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Boxes = NDArray[np.float32]

SWEEP_LIMIT: Final = 2048
"""Inputs up to this many items are built by numpy alone: numba takes seconds to compile, and half a second to load."""
BINS: Final = 32
TIE: Final = 1.0 + 1e-9
"""Costs within this factor count as equal, so that rounding does not choose lopsided splits of equal boxes."""


@dataclass(frozen=True)
class BinaryTree:
    """Inner nodes only, the root first, children after their parents; n items have n - 1 inner nodes."""

    child: NDArray[np.int32]
    """(n - 1, 2): an inner node, or ~position in `order`."""
    lo: Boxes
    """(n - 1, 3): bounds."""
    hi: Boxes
    count: NDArray[np.int32]
    """(n - 1,): items below."""
    first: NDArray[np.int32]
    """(n - 1,): position in `order` of the first item below; a node's items are contiguous."""
    order: NDArray[np.int32]
    """(n,): items by position."""


def _empty(n: int) -> BinaryTree:
    m = max(n - 1, 0)
    box = (m, 3)
    return BinaryTree(
        np.empty((m, 2), np.int32),
        np.empty(box, np.float32),
        np.empty(box, np.float32),
        np.empty(m, np.int32),
        np.empty(m, np.int32),
        np.arange(n, dtype=np.int32),
    )


def build_binary(lo: Boxes, hi: Boxes, sah_depth: int, sweep_limit: int = SWEEP_LIMIT) -> BinaryTree:
    """A tree over n boxes (n, 3), float32, finite.

    sah_depth: below this depth nodes are halved by count instead, which bounds the depth of what follows.
    """
    n = len(lo)
    tree = _empty(n)
    if n < 2:
        return tree
    if n <= sweep_limit:
        _sweep(lo, hi, sah_depth, tree)
    else:
        binned = compiled(_binned)
        binned(lo, hi, sah_depth, BINS, tree.child, tree.lo, tree.hi, tree.first, tree.count, tree.order)
    return tree


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled by numba, kept on disk. No fast-math: trees must not depend on the machine."""
    import numba

    return numba.njit(cache=True, error_model="numpy")(function)  # type: ignore[no-any-return]


def _half_areas(lo: NDArray[np.float64], hi: NDArray[np.float64]) -> NDArray[np.float64]:
    d = hi - lo
    return d[..., 0] * d[..., 1] + d[..., 1] * d[..., 2] + d[..., 2] * d[..., 0]


def _sweep_split(lo: NDArray[np.float64], hi: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """The order along the best axis and the size of the left part, over every split along every axis."""
    n = len(lo)
    orders = np.argsort(lo + hi, axis=0, kind="stable")
    l, h = lo[orders], hi[orders]  # (n, axis, 3)
    left = _half_areas(np.minimum.accumulate(l)[:-1], np.maximum.accumulate(h)[:-1])
    right = _half_areas(np.minimum.accumulate(l[::-1])[::-1][1:], np.maximum.accumulate(h[::-1])[::-1][1:])
    size = np.arange(1, n, dtype=np.float64)[:, None]
    cost = left * size + right * (n - size)
    unevenness = np.abs(2.0 * size - n) + 0.125 * np.arange(3)
    split, axis = np.unravel_index(
        int(np.argmin(np.where(cost <= cost.min() * TIE, unevenness, np.inf))), cost.shape
    )
    return orders[:, axis], int(split) + 1


def _sweep(lo: Boxes, hi: Boxes, sah_depth: int, tree: BinaryTree) -> None:
    l64, h64 = lo.astype(np.float64), hi.astype(np.float64)
    stack = [(0, 0, len(lo), 0)]
    used = 1
    while stack:
        node, first, count, depth = stack.pop()
        items = tree.order[first : first + count]
        tree.lo[node], tree.hi[node] = lo[items].min(axis=0), hi[items].max(axis=0)
        tree.first[node], tree.count[node] = first, count
        if depth < sah_depth and count > 2:
            order, split = _sweep_split(l64[items], h64[items])
        else:
            axis = int(np.argmax(tree.hi[node] - tree.lo[node]))
            order, split = (
                np.argsort((l64 + h64)[items, axis], kind="stable") if count > 2 else np.arange(2),
                count // 2,
            )
        tree.order[first : first + count] = items[order]
        for side, (start, size) in enumerate(((first, split), (first + split, count - split))):
            if size == 1:
                tree.child[node, side] = ~start
            else:
                tree.child[node, side] = used
                stack.append((used, start, size, depth + 1))
                used += 1


def _binned(lo, hi, sah_depth, bins, child, node_lo, node_hi, node_first, node_count, order):  # type: ignore[no-untyped-def]
    """Binned splits (Wald 2007); compiled by numba, hence plain loops and no types. Fills the tree's arrays."""
    n = order.shape[0]
    stack = np.empty((sah_depth + 64, 4), np.int64)
    stack[0, 0] = 0
    stack[0, 1] = 0
    stack[0, 2] = n
    stack[0, 3] = 0
    depth_of_stack = 1
    used = 1
    infinity = np.float32(np.inf)
    bin_lo = np.empty((3, bins, 3), np.float32)
    bin_hi = np.empty((3, bins, 3), np.float32)
    bin_count = np.empty((3, bins), np.int64)
    right_cost = np.empty(bins, np.float64)
    right_count = np.empty(bins, np.int64)
    scale = np.empty(3, np.float32)
    c_lo = np.empty(3, np.float32)
    c_hi = np.empty(3, np.float32)
    b_lo = np.empty(3, np.float32)
    b_hi = np.empty(3, np.float32)
    while depth_of_stack > 0:
        depth_of_stack -= 1
        node = stack[depth_of_stack, 0]
        first = stack[depth_of_stack, 1]
        count = stack[depth_of_stack, 2]
        depth = stack[depth_of_stack, 3]
        for a in range(3):
            c_lo[a] = infinity
            b_lo[a] = infinity
            c_hi[a] = -infinity
            b_hi[a] = -infinity
        for i in range(first, first + count):
            p = order[i]
            for a in range(3):
                x = lo[p, a]
                y = hi[p, a]
                c = x + y
                b_lo[a] = x if x < b_lo[a] else b_lo[a]
                b_hi[a] = y if y > b_hi[a] else b_hi[a]
                c_lo[a] = c if c < c_lo[a] else c_lo[a]
                c_hi[a] = c if c > c_hi[a] else c_hi[a]
        for a in range(3):
            node_lo[node, a] = b_lo[a]
            node_hi[node, a] = b_hi[a]
        node_first[node] = first
        node_count[node] = count
        nbins = bins if count >= bins // 2 else max(4, count)
        best = np.inf
        best_axis = -1
        best_bin = 0
        if depth < sah_depth and count > 2:
            for a in range(3):
                extent = c_hi[a] - c_lo[a]
                scale[a] = np.float32(nbins) * np.float32(0.99999) / extent if extent > 0 else np.float32(0)
                if not scale[a] < np.float32(1e30):
                    scale[a] = np.float32(0)
                for j in range(nbins):
                    bin_count[a, j] = 0
                    for d in range(3):
                        bin_lo[a, j, d] = infinity
                        bin_hi[a, j, d] = -infinity
            for i in range(first, first + count):
                p = order[i]
                for a in range(3):
                    j = int((lo[p, a] + hi[p, a] - c_lo[a]) * scale[a])
                    bin_count[a, j] += 1
                    for d in range(3):
                        x = lo[p, d]
                        y = hi[p, d]
                        bin_lo[a, j, d] = x if x < bin_lo[a, j, d] else bin_lo[a, j, d]
                        bin_hi[a, j, d] = y if y > bin_hi[a, j, d] else bin_hi[a, j, d]
            for a in range(3):
                if scale[a] == 0:
                    continue
                for d in range(3):
                    b_lo[d] = infinity
                    b_hi[d] = -infinity
                total = 0
                for j in range(nbins - 1, 0, -1):
                    for d in range(3):
                        b_lo[d] = min(b_lo[d], bin_lo[a, j, d])
                        b_hi[d] = max(b_hi[d], bin_hi[a, j, d])
                    total += bin_count[a, j]
                    dx = np.float64(b_hi[0] - b_lo[0])
                    dy = np.float64(b_hi[1] - b_lo[1])
                    dz = np.float64(b_hi[2] - b_lo[2])
                    right_count[j] = total
                    right_cost[j] = (dx * dy + dy * dz + dz * dx) * total if total > 0 else 0.0
                for d in range(3):
                    b_lo[d] = infinity
                    b_hi[d] = -infinity
                total = 0
                for j in range(1, nbins):
                    for d in range(3):
                        b_lo[d] = min(b_lo[d], bin_lo[a, j - 1, d])
                        b_hi[d] = max(b_hi[d], bin_hi[a, j - 1, d])
                    total += bin_count[a, j - 1]
                    if total == 0 or right_count[j] == 0:
                        continue
                    dx = np.float64(b_hi[0] - b_lo[0])
                    dy = np.float64(b_hi[1] - b_lo[1])
                    dz = np.float64(b_hi[2] - b_lo[2])
                    cost = (dx * dy + dy * dz + dz * dx) * total + right_cost[j]
                    if cost < best:
                        best = cost
                        best_axis = a
                        best_bin = j
        split = count // 2
        if best_axis >= 0:
            i = first
            j = first + count - 1
            while i <= j:
                p = order[i]
                if int((lo[p, best_axis] + hi[p, best_axis] - c_lo[best_axis]) * scale[best_axis]) < best_bin:
                    i += 1
                else:
                    order[i] = order[j]
                    order[j] = p
                    j -= 1
            if first < i < first + count:
                split = i - first
        elif depth >= sah_depth and count > 2:
            axis = 0
            for a in range(1, 3):
                if c_hi[a] - c_lo[a] > c_hi[axis] - c_lo[axis]:
                    axis = a
            keys = np.empty(count, np.float32)
            for i in range(count):
                p = order[first + i]
                keys[i] = lo[p, axis] + hi[p, axis]
            items = order[first : first + count].copy()
            by_key = np.argsort(keys, kind="mergesort")
            for i in range(count):
                order[first + i] = items[by_key[i]]
        for side in range(1, -1, -1):
            start = first if side == 0 else first + split
            size = split if side == 0 else count - split
            if size == 1:
                child[node, side] = ~start
            else:
                child[node, side] = used
                stack[depth_of_stack, 0] = used
                stack[depth_of_stack, 1] = start
                stack[depth_of_stack, 2] = size
                stack[depth_of_stack, 3] = depth + 1
                depth_of_stack += 1
                used += 1
