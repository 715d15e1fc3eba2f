"""Binned splits by the surface area heuristic (Wald 2007), compiled by numba: for large inputs.

Importing this module imports numba. No fast-math: trees must not depend on the machine. Bins are those of
centroids (lo + hi, twice the center), along each axis of the node's centroids' box.
"""

# mypy: disable-error-code="no-untyped-def,misc,untyped-decorator"
from __future__ import annotations

import numba
import numpy as np

BINS = 32
INSIDE = np.float32(0.99999)  # keeps the last centroid in the last bin
LARGEST_SCALE = np.float32(1e30)  # boxes so small that a bin number could overflow are halved by count

jit = numba.njit(cache=True, error_model="numpy")


@jit
def _bound(lo, hi, order, first, count, box, centroids):
    """The node's box and its centroids' box, (2, 3) each."""
    for a in range(3):
        box[0, a] = centroids[0, a] = np.float32(np.inf)
        box[1, a] = centroids[1, a] = np.float32(-np.inf)
    for i in range(first, first + count):
        p = order[i]
        for a in range(3):
            x = lo[p, a]
            y = hi[p, a]
            c = x + y
            box[0, a] = x if x < box[0, a] else box[0, a]
            box[1, a] = y if y > box[1, a] else box[1, a]
            centroids[0, a] = c if c < centroids[0, a] else centroids[0, a]
            centroids[1, a] = c if c > centroids[1, a] else centroids[1, a]


@jit
def _scales(centroids, bins, scale):
    """Bins per length, 0 along axes where all centroids are the same."""
    for a in range(3):
        extent = centroids[1, a] - centroids[0, a]
        scale[a] = np.float32(bins) * INSIDE / extent if extent > 0 else np.float32(0)
        if not scale[a] < LARGEST_SCALE:
            scale[a] = np.float32(0)


@jit
def _fill(lo, hi, order, first, count, centroids, scale, bins, bin_lo, bin_hi, bin_count):
    for a in range(3):
        for j in range(bins):
            bin_count[a, j] = 0
            for d in range(3):
                bin_lo[a, j, d] = np.float32(np.inf)
                bin_hi[a, j, d] = np.float32(-np.inf)
    for i in range(first, first + count):
        p = order[i]
        for a in range(3):
            j = int((lo[p, a] + hi[p, a] - centroids[0, a]) * scale[a])
            bin_count[a, j] += 1
            for d in range(3):
                x = lo[p, d]
                y = hi[p, d]
                bin_lo[a, j, d] = x if x < bin_lo[a, j, d] else bin_lo[a, j, d]
                bin_hi[a, j, d] = y if y > bin_hi[a, j, d] else bin_hi[a, j, d]


@jit
def _grow(box, lo, hi):
    for d in range(3):
        box[0, d] = min(box[0, d], lo[d])
        box[1, d] = max(box[1, d], hi[d])


@jit
def _half_area(box):
    x = np.float64(box[1, 0] - box[0, 0])
    y = np.float64(box[1, 1] - box[0, 1])
    z = np.float64(box[1, 2] - box[0, 2])
    return x * y + y * z + z * x


@jit
def _best_of_axis(bins, bin_lo, bin_hi, bin_count, box, right_cost, right_count):
    """Least cost over the borders between bins (infinite: none splits), and the first bin on its right."""
    box[0, :] = np.inf
    box[1, :] = -np.inf
    total = 0
    for j in range(bins - 1, 0, -1):
        _grow(box, bin_lo[j], bin_hi[j])
        total += bin_count[j]
        right_count[j] = total
        right_cost[j] = _half_area(box) * total if total > 0 else 0.0
    box[0, :] = np.inf
    box[1, :] = -np.inf
    total = 0
    best = np.inf
    border = 0
    for j in range(1, bins):
        _grow(box, bin_lo[j - 1], bin_hi[j - 1])
        total += bin_count[j - 1]
        if total == 0 or right_count[j] == 0:
            continue
        cost = _half_area(box) * total + right_cost[j]
        if cost < best:
            best = cost
            border = j
    return best, border


@jit
def _partition(lo, hi, order, first, count, axis, start, scale, border):
    """Items of bins below the border to the left; how many they are."""
    i = first
    j = first + count - 1
    while i <= j:
        p = order[i]
        if int((lo[p, axis] + hi[p, axis] - start) * scale) < border:
            i += 1
        else:
            order[i] = order[j]
            order[j] = p
            j -= 1
    return i - first


@jit
def _halve(lo, hi, order, first, count, centroids):
    """Order along the longest axis of the centroids, for a split by count."""
    axis = 0
    for a in range(1, 3):
        if centroids[1, a] - centroids[0, a] > centroids[1, axis] - centroids[0, axis]:
            axis = a
    items = order[first : first + count].copy()
    along = np.empty(count, np.float32)
    for i in range(count):
        along[i] = lo[items[i], axis] + hi[items[i], axis]
    order[first : first + count] = items[np.argsort(along, kind="mergesort")]


@jit
def build_binned(lo, hi, sah_depth, child, node_lo, node_hi, node_first, node_count, order):
    """Fill a BinaryTree's arrays over boxes (n, 3), n > 1; see accel/binary.py."""
    stack = np.empty((sah_depth + 64, 4), np.int64)  # halving below sah_depth adds at most 32 levels
    stack[0, :3] = 0
    stack[0, 2] = order.shape[0]
    stack[0, 3] = 0
    waiting = 1
    used = 1
    bin_lo = np.empty((3, BINS, 3), np.float32)
    bin_hi = np.empty((3, BINS, 3), np.float32)
    bin_count = np.empty((3, BINS), np.int64)
    right_cost = np.empty(BINS, np.float64)
    right_count = np.empty(BINS, np.int64)
    scale = np.empty(3, np.float32)
    centroids = np.empty((2, 3), np.float32)
    box = np.empty((2, 3), np.float32)
    while waiting > 0:
        waiting -= 1
        node, first, count, depth = stack[waiting]
        _bound(lo, hi, order, first, count, box, centroids)
        node_lo[node] = box[0]
        node_hi[node] = box[1]
        node_first[node] = first
        node_count[node] = count
        split = 0
        if count > 2 and depth < sah_depth:
            bins = BINS if count >= BINS // 2 else max(4, count)
            _scales(centroids, bins, scale)
            _fill(lo, hi, order, first, count, centroids, scale, bins, bin_lo, bin_hi, bin_count)
            best = np.inf
            axis = -1
            border = 0
            for a in range(3):
                if scale[a] > 0:
                    cost, at = _best_of_axis(
                        bins, bin_lo[a], bin_hi[a], bin_count[a], box, right_cost, right_count
                    )
                    if cost < best:
                        best = cost
                        axis = a
                        border = at
            if axis >= 0:
                split = _partition(lo, hi, order, first, count, axis, centroids[0, axis], scale[axis], border)
        elif count > 2:
            _halve(lo, hi, order, first, count, centroids)
        if split == 0 or split == count:
            split = count // 2
        for side in range(1, -1, -1):
            start = first if side == 0 else first + split
            size = split if side == 0 else count - split
            if size == 1:
                child[node, side] = ~start
            else:
                child[node, side] = used
                stack[waiting, 0] = used
                stack[waiting, 1] = start
                stack[waiting, 2] = size
                stack[waiting, 3] = depth + 1
                waiting += 1
                used += 1
