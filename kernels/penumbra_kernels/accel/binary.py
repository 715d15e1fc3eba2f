"""Binary trees over boxes by the surface area heuristic, down to single items.

Two builders with one result type: a full sweep in numpy for small inputs (no compiler to wait for), and
binning, compiled by numba, for large ones. Both are deterministic: equal costs go to the most even split,
equal positions to the lower item. Any tree gives the same hits, so which of them ran does not show in a
picture.
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
"""Inputs up to this many items are built by numpy alone: numba takes seconds to compile, and half a second
to load."""
TIE: Final = 1.0 + 1e-9
"""Costs within this factor count as equal, so that rounding does not choose lopsided splits of equal
boxes."""


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
        from penumbra_kernels.accel.binned import build_binned  # imports numba

        build_binned(lo, hi, sah_depth, tree.child, tree.lo, tree.hi, tree.first, tree.count, tree.order)
    return tree


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled by numba, kept on disk. No fast-math: trees must not depend on the machine."""
    import numba

    return numba.njit(cache=True, error_model="numpy")(function)


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
