"""Collapsing a binary tree to eight children a node, at the least expected cost, and writing it out as NODE8.

Dynamic programming over "this subtree as i roots" (Ylitie, Karras, Laine 2017, section 3.1), with packets of
eight triangles as leaves. These functions run as plain Python on small trees and compiled by numba on large
ones: hence plain loops and no types.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

WIDTH = 8
NODE_COST = 1.0
PACKET_COST = 0.5
MAX_PACKETS = 2
LEAF = 1 << 31
DEFORMING = (1 << 31) | (3 << 29)
COUNT_SHIFT = 27
UINTS = 64  # 4-byte words of a node
CHILD = 48  # where its child words begin
NOTHING = -(1 << 31)


def plan(child, lo, hi, count, item_cost, item_key, C, D, split8, is_leaf, key):
    """Fill the plan for every inner node, children before parents.

    item_cost, item_key: by position; key >= 0: triangles that may share a packet with others of that key,
    -1: alone. C, D: (m, 7): least cost as i + 1 roots, and how many of them the left child gets (0: as with
    one root fewer). split8: how many of a wide node's eight children the left child makes. is_leaf: whether
    packets are cheaper.
    """
    for i in range(child.shape[0] - 1, -1, -1):
        l = child[i, 0]
        r = child[i, 1]
        dx = float(hi[i, 0] - lo[i, 0])
        dy = float(hi[i, 1] - lo[i, 1])
        dz = float(hi[i, 2] - lo[i, 2])
        area = dx * dy + dy * dz + dz * dx
        left_key = item_key[~l] if l < 0 else key[l]
        right_key = item_key[~r] if r < 0 else key[r]
        key[i] = left_key if left_key == right_key else -1
        best = np.inf
        best_k = 1
        for k in range(1, WIDTH):
            s = (item_cost[~l] if l < 0 else C[l, k - 1]) + (item_cost[~r] if r < 0 else C[r, WIDTH - k - 1])
            if s < best:
                best = s
                best_k = k
        split8[i] = best_k
        as_node = best + area * NODE_COST
        packets = (count[i] + WIDTH - 1) // WIDTH
        limit = 0
        if key[i] == 0:
            limit = MAX_PACKETS
        elif key[i] > 0:
            limit = 1
        as_leaf = area * packets * PACKET_COST if packets <= limit else np.inf
        is_leaf[i] = 1 if as_leaf <= as_node and packets <= limit else 0
        C[i, 0] = as_leaf if is_leaf[i] else as_node
        D[i, 0] = 0
        for j in range(2, WIDTH):
            best = C[i, j - 2]
            best_k = 0
            for k in range(1, j):
                s = (item_cost[~l] if l < 0 else C[l, k - 1]) + (item_cost[~r] if r < 0 else C[r, j - k - 1])
                if s < best:
                    best = s
                    best_k = k
            C[i, j - 1] = best
            D[i, j - 1] = best_k


def spread(child, count, item_key, copies, D, split8, is_leaf, key, table, first_child):
    """Give every wide node its place and its children: (nodes, packets).

    table: (m, 8) children in the binary tree's order, NOTHING where there is none; first_child: (m,) place
    of a node's first inner child. Siblings are neighbours, and nodes lie depth first. copies: by key,
    packets of a group.
    """
    stack = np.empty((1024, 2), np.int64)
    refs = np.empty(2 * WIDTH, np.int64)
    roots = np.empty(2 * WIDTH, np.int64)
    stack[0, 0] = 0
    stack[0, 1] = 0
    waiting = 1
    slots = 1
    packets = 0
    while waiting > 0:
        waiting -= 1
        slot = stack[waiting, 0]
        node = stack[waiting, 1]
        refs[0] = child[node, 1]
        roots[0] = WIDTH - split8[node]
        refs[1] = child[node, 0]
        roots[1] = split8[node]
        top = 2
        n = 0
        while top > 0:
            top -= 1
            ref = refs[top]
            j = roots[top]
            while ref >= 0 and j > 1 and D[ref, j - 1] == 0:
                j -= 1
            if ref < 0 or j == 1:
                table[slot, n] = ref
                n += 1
                continue
            refs[top] = child[ref, 1]
            roots[top] = j - D[ref, j - 1]
            refs[top + 1] = child[ref, 0]
            roots[top + 1] = D[ref, j - 1]
            top += 2
        first_child[slot] = slots
        for j in range(n):
            ref = table[slot, j]
            if ref >= 0 and is_leaf[ref] == 0:
                slots += 1
                continue
            group = item_key[~ref] if ref < 0 else key[ref]
            if group == 0:
                packets += 1 if ref < 0 else (count[ref] + WIDTH - 1) // WIDTH
            elif group > 0:
                packets += copies[group]
        for j in range(n, WIDTH):
            table[slot, j] = NOTHING
        if waiting + WIDTH > stack.shape[0]:
            larger = np.empty((2 * stack.shape[0], 2), np.int64)
            larger[: stack.shape[0]] = stack
            stack = larger
        place = slots
        for j in range(n - 1, -1, -1):  # the first child comes out of the stack next
            ref = table[slot, j]
            if ref >= 0 and is_leaf[ref] == 0:
                place -= 1
                stack[waiting, 0] = place
                stack[waiting, 1] = ref
                waiting += 1
    return slots, packets


def write(
    table, first_child, lo, hi, first, count, item_lo, item_hi, order, item_key, item_word, copies,
    is_leaf, key,
    nodes, words, packet_items, packet_keyframe, need,
):  # fmt: skip
    """Write nodes and packets; returns the deepest stack that a traversal may need.

    nodes, words: (slots, 64), one memory as float32 and uint32. packet_items: (p, 8) positions. need:
    (slots,) scratch.
    """
    packets = 0
    for slot in range(nodes.shape[0]):
        inner = 0
        for j in range(WIDTH):
            ref = table[slot, j]
            word = LEAF
            if ref == NOTHING:
                for d in range(3):
                    nodes[slot, 16 * d + j] = np.inf
                    nodes[slot, 16 * d + 8 + j] = -np.inf
            elif ref < 0:
                for d in range(3):
                    nodes[slot, 16 * d + j] = item_lo[order[~ref], d]
                    nodes[slot, 16 * d + 8 + j] = item_hi[order[~ref], d]
            else:
                for d in range(3):
                    nodes[slot, 16 * d + j] = lo[ref, d]
                    nodes[slot, 16 * d + 8 + j] = hi[ref, d]
            if ref >= 0 and is_leaf[ref] == 0:
                word = first_child[slot] + inner
                inner += 1
            elif ref != NOTHING:
                begin = ~ref if ref < 0 else first[ref]
                size = 1 if ref < 0 else count[ref]
                group = item_key[begin]
                if group < 0:
                    word = int(item_word[order[begin]])
                else:
                    rows = int(copies[group] if group > 0 else (size + WIDTH - 1) // WIDTH)
                    word = (DEFORMING if group > 0 else LEAF | (rows << COUNT_SHIFT)) | packets
                    for row in range(rows):
                        for q in range(WIDTH):
                            lane = q if group > 0 else row * WIDTH + q
                            packet_items[packets + row, q] = begin + min(lane, size - 1)
                        packet_keyframe[packets + row] = row if group > 0 else 0
                    packets += rows
            words[slot, CHILD + j] = word
        for j in range(CHILD + WIDTH, UINTS):
            words[slot, j] = 0
    for slot in range(nodes.shape[0] - 1, -1, -1):
        used = 0
        below = 0
        for j in range(WIDTH):
            found = int(words[slot, CHILD + j])
            if found != LEAF:
                used += 1
            if found < LEAF:
                below = max(below, need[found])
        need[slot] = used - 1 + below
    return need[0]
