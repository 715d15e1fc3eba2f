"""The light tree: lights -> LIGHT_NODE, eight children a node, and every light's place in the tree's order.

A binary tree is split from the top, all nodes of a level together: by the cheapest of BINS - 1 planes on each axis,
where the cost of a side is its strength times the square of its diagonal times the solid angle into which it shines (the
surface area orientation heuristic of Conty Estevez and Kulla 2018, equation 1). The diagonal's square stands for the
box's area, since weights see a sphere around the box, and lamps in a row have no area. The spread of directions is told
by the length of their mean (Mardia and Jupp 2000, 9.2), which sums over bins, where the paper's cone around them does
not. Then nodes take eight children each.

Deterministic; lengths in metres relative to the anchor, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.compile.alias import MAX_ENTRIES
from penumbra_kernels.compile.light_bounds import LightBounds
from penumbra_kernels.layout import CONSTANTS, LIGHT_NODE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WIDTH: Final = 8
"""Children a node."""
BINS: Final = 12
NONE: Final = CONSTANTS["NONE"]
LEAST_STRENGTH: Final = 1e-30
"""Share of the total that a light with any power has at least: float32 keeps it."""
ANGLE_SLACK: Final = 1e-3
"""Radians by which cones are wider than they are: cosines near 1 have rounding errors that are as large as angles."""
LIGHT_LANE: Final = np.dtype([(name, LIGHT_NODE[name].base) for name in LIGHT_NODE.names or ()])
"""One child of a LIGHT_NODE."""


@dataclass(frozen=True)
class LightTree:
    """What cl/lights/tree.cl walks."""

    nodes: NDArray[Any]
    """(n,) of LIGHT_NODE, the root first; empty where no light has power."""
    leaf: NDArray[np.uint32]
    """(lights,) place in the tree's order, or NONE for lights without power."""


@dataclass(frozen=True)
class _Lights:
    """LightBounds as arrays; only those with power."""

    center: Floats
    radius: Floats
    axis: Floats
    spread: Floats
    falloff: Floats
    strength: Floats

    @property
    def far(self) -> NDArray[np.bool_]:
        return self.radius < 0.0


@dataclass(frozen=True)
class _Binary:
    """Segments [start, end) of the order; children by number, -1 where a segment was not split."""

    order: Ints
    start: Ints
    end: Ints
    left: Ints
    right: Ints


def build_light_tree(bounds: Sequence[LightBounds]) -> LightTree:
    """The tree over lights in their order. Raises ValueError for more than MAX_ENTRIES of them."""
    if len(bounds) > MAX_ENTRIES:
        raise ValueError(f"{len(bounds)} lights to choose from, but at most {MAX_ENTRIES} are possible")
    leaf = np.full(len(bounds), NONE, np.uint32)
    powered = np.array([i for i, b in enumerate(bounds) if b.strength > 0.0], np.int64)
    if not len(powered):
        return LightTree(np.zeros(0, LIGHT_NODE), leaf)
    lights = _arrays([bounds[i] for i in powered])
    binary = _split(lights)
    leaf[powered[binary.order]] = np.arange(len(powered))
    return LightTree(_Widening(lights, binary, powered).nodes(), leaf)


def _arrays(bounds: Sequence[LightBounds]) -> _Lights:
    strength = np.array([b.strength for b in bounds])
    radius = np.array([b.radius for b in bounds])
    far = radius < 0.0
    for kind in (far, ~far):
        if kind.any():
            strength[kind] /= strength[kind].max()
            strength[kind] = np.maximum(strength[kind] / strength[kind].sum(), LEAST_STRENGTH)
    return _Lights(
        np.array([b.center for b in bounds]),
        radius,
        np.array([b.axis for b in bounds]),
        np.array([b.spread for b in bounds]),
        np.array([b.falloff for b in bounds]),
        strength,
    )


def _ranges(start: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Every index of the segments in turn, and which segment it is of."""
    owner = np.repeat(np.arange(len(start)), count)
    first = np.cumsum(count) - count
    return np.arange(len(owner)) - first[owner] + start[owner], owner


def _split(lights: _Lights) -> _Binary:
    """Level by level: first far lights from near ones, then by cost, until no segment has more than WIDTH."""
    count = len(lights.radius)
    order = np.argsort(lights.far, kind="stable")
    near = count - int(lights.far.sum())
    start, end, left, right = [0], [count], [-1], [-1]

    def add(owner: int, a: int, b: int) -> int:
        start.append(a)
        end.append(b)
        left.append(-1)
        right.append(-1)
        return len(start) - 1

    level = [0]
    if 0 < near < count:
        left[0], right[0] = add(0, 0, near), add(0, near, count)
        level = [1, 2]
    while True:
        level = [node for node in level if end[node] - start[node] > WIDTH]
        if not level:
            break
        first = np.array([start[node] for node in level])
        size = np.array([end[node] for node in level]) - first
        places, owner = _ranges(first, size)
        members = order[places]
        beyond = _beyond(lights, members, owner, first, size)
        order[places] = members[np.lexsort((beyond, owner))]
        cuts = first + size - np.bincount(owner, beyond, len(level)).astype(np.int64)
        following = []
        for node, cut in zip(level, cuts.tolist(), strict=True):
            left[node], right[node] = add(node, start[node], cut), add(node, cut, end[node])
            following += [left[node], right[node]]
        level = following
    return _Binary(order, *(np.array(a, np.int64) for a in (start, end, left, right)))


def _beyond(lights: _Lights, members: Ints, owner: Ints, first: Ints, size: Ints) -> NDArray[np.bool_]:
    """Which members of each segment go to its right side."""
    center = lights.center[members]
    offsets = np.cumsum(size) - size
    lo, hi = np.minimum.reduceat(center, offsets), np.maximum.reduceat(center, offsets)
    extent = hi - lo
    scale = np.divide(BINS, extent, out=np.zeros_like(extent), where=extent > 0.0)
    bins = np.minimum(((center - lo[owner]) * scale[owner]).astype(np.int64), BINS - 1)
    cost = _costs(lights, members, owner, bins, len(size))
    best = cost.reshape(len(size), -1).argmin(axis=1)
    axis, plane = np.divmod(best, BINS - 1)
    beyond = bins[np.arange(len(members)), axis[owner]] > plane[owner]
    # Lights in one place: halves, by their order.
    stuck = ~np.isfinite(cost.reshape(len(size), -1).min(axis=1))
    rank = np.arange(len(members)) - offsets[owner]
    return np.where(stuck[owner], rank >= size[owner] // 2, beyond)


def _costs(lights: _Lights, members: Ints, owner: Ints, bins: Ints, segments: int) -> Floats:
    """(segments, 3, BINS - 1): cost of cutting behind each bin but the last, infinite where a side is empty."""
    shape = (segments, 3, BINS)
    keys = (owner[:, None] * 3 + np.arange(3)) * BINS + bins
    flat, slots = keys.ravel(), segments * 3 * BINS
    strength = lights.strength[members]
    sums: list[Floats] = [np.ones(len(members)), strength, *(lights.axis[members] * strength[:, None]).T]
    totals = np.stack([np.bincount(flat, np.repeat(s, 3), slots).reshape(shape) for s in sums]).astype(
        np.float64
    )
    reach = np.maximum(lights.radius[members], 0.0)[:, None]
    corners = np.concatenate([lights.center[members] - reach, -lights.center[members] - reach], axis=1)
    boxes = np.full((slots, 6), np.inf)
    by_key = np.argsort(flat, kind="stable")
    used, begins = np.unique(flat[by_key], return_index=True)
    boxes[used] = np.minimum.reduceat(np.repeat(corners, 3, axis=0)[by_key], begins)
    by_bin = boxes.reshape(*shape, 6)
    cost = np.zeros((segments, 3, BINS - 1))
    for turn in (slice(None), slice(None, None, -1)):
        running = np.cumsum(totals[..., turn], axis=-1)[..., :-1][..., turn]
        box = np.minimum.accumulate(by_bin[:, :, turn], axis=2)[:, :, :-1][:, :, turn]
        cost += _cost(running, box)
    return cost


def _cost(totals: Floats, box: Floats) -> Floats:
    """totals: (5, ...) count, strength, and strength times axis; box: (..., 6) lower corner and minus the upper."""
    count, strength = totals[0], totals[1]
    empty = count == 0.0
    diagonal = np.where(empty[..., None], 0.0, -box[..., 3:] - box[..., :3])
    length = np.linalg.norm(totals[2:], axis=0) / np.where(empty, 1.0, strength)
    # A mean of length 1 is one direction, of length 0 all of them.
    spread = np.arccos(np.clip(2.0 * length - 1.0, -1.0, 1.0))
    cost = strength * (diagonal**2).sum(axis=-1) * _solid_angle(spread)
    return np.where(empty, np.inf, cost)


def _solid_angle(spread: Floats) -> Floats:
    """Into which normals within `spread` emit, weighed by the cosine off them (equation 1's M_Omega, falloff pi / 2)."""
    reach = np.minimum(spread + 0.5 * np.pi, np.pi)
    sine, cosine = np.sin(spread), np.cos(spread)
    around = 2.0 * reach * sine - np.cos(spread - 2.0 * reach) - 2.0 * spread * sine + cosine
    return 2.0 * np.pi * (1.0 - cosine) + 0.5 * np.pi * around


class _Widening:
    """Binary tree -> nodes of eight children. Children are segments, or, below segments that were not split, lights."""

    def __init__(self, lights: _Lights, binary: _Binary, index: Ints) -> None:
        self.lights, self.binary, self.index = lights, binary, index

    def nodes(self) -> NDArray[Any]:
        level = np.zeros(1, np.int64)
        out: list[NDArray[Any]] = []
        count = 1
        while len(level):
            nodes, level = self._level(level, count)
            out.append(nodes)
            count += len(level)
        return np.concatenate(out)

    def _level(self, level: Ints, next_node: int) -> tuple[NDArray[Any], Ints]:
        """Nodes for these segments, and the segments that get nodes next, numbered from next_node on."""
        start, count, segment = self._children(level)
        flat = count.ravel() > 0
        record = np.zeros(len(level) * WIDTH, LIGHT_LANE)
        record[flat] = self._bounds(start.ravel()[flat], count.ravel()[flat])
        record["count"] = count.ravel()
        inner = flat & (count.ravel() > 1)
        single = flat & ~inner
        record["child"][single] = (
            CONSTANTS["LEAF_FLAG"] | self.index[self.binary.order[start.ravel()[single]]]
        )
        record["child"][inner] = next_node + np.arange(inner.sum())
        nodes = np.zeros(len(level), LIGHT_NODE)
        for name in LIGHT_LANE.names or ():
            nodes[name] = record[name].reshape(len(level), WIDTH)
        return nodes, segment.ravel()[inner]

    def _children(self, level: Ints) -> tuple[Ints, Ints, Ints]:
        """(n, 8) first place, number of lights and segment of the children, in the order of their places."""
        b = self.binary
        slots = np.full((len(level), WIDTH), -1, np.int64)
        slots[:, 0] = level
        rows = np.arange(len(level))
        for free in range(1, WIDTH):
            size = np.where((slots >= 0) & (b.left[slots] >= 0), b.end[slots] - b.start[slots], 0)
            largest = size.argmax(axis=1)
            grows = rows[size[rows, largest] > 0]
            opened = slots[grows, largest[grows]]
            slots[grows, largest[grows]] = b.left[opened]
            slots[grows, free] = b.right[opened]
        start = np.where(slots >= 0, b.start[slots], len(b.order))
        sorting = np.argsort(start, axis=1, kind="stable")
        slots = np.take_along_axis(slots, sorting, axis=1)
        start = np.take_along_axis(start, sorting, axis=1)
        count = np.where(slots >= 0, b.end[slots] - b.start[slots], 0)
        whole = b.left[level] < 0  # at most eight lights: each is a child
        places = b.start[level][:, None] + np.arange(WIDTH)
        start = np.where(whole[:, None], places, start)
        count = np.where(whole[:, None], (places < b.end[level][:, None]).astype(np.int64), count)
        return start, count, slots

    def _bounds(self, start: Ints, count: Ints) -> NDArray[Any]:
        """(n,) lanes of segments, none of them empty."""
        places, owner = _ranges(start, count)
        members = self.binary.order[places]
        offsets = np.cumsum(count) - count
        lights = self.lights
        out = np.zeros(len(start), LIGHT_LANE)
        far = lights.far[members[offsets]]
        center, radius = _spheres(lights, members, owner, offsets)
        axis, spread = _cones(lights.axis[members], lights.spread[members], owner, offsets)
        to_far, far_spread = _cones(lights.center[members], lights.spread[members], owner, offsets)
        center = np.where(far[:, None], to_far, center)
        spread = np.where(far, far_spread, spread)
        falloff = np.minimum(np.maximum.reduceat(lights.falloff[members], offsets) + ANGLE_SLACK, np.pi)
        for i, name in enumerate("xyz"):
            out[name], out[f"axis_{name}"] = center[:, i], axis[:, i]
        out["radius"] = np.where(far, -1.0, radius)
        # The sine of pi rounds to more than 0: angles within it are told by the sign of a sine (cl/lights/tree.cl).
        out["cos_spread"], out["sin_spread"], out["cos_falloff"] = (
            np.cos(spread),
            np.sin(spread),
            np.cos(falloff),
        )
        out["strength"] = np.add.reduceat(lights.strength[members], offsets)
        return out


def _spheres(lights: _Lights, members: Ints, owner: Ints, offsets: Ints) -> tuple[Floats, Floats]:
    """Spheres around near lights' spheres: about the middle of their box, through whichever reaches farthest."""
    center, radius = lights.center[members], np.maximum(lights.radius[members], 0.0)
    lo = np.minimum.reduceat(center - radius[:, None], offsets)
    hi = np.maximum.reduceat(center + radius[:, None], offsets)
    middle = (0.5 * (lo + hi)).astype(np.float32).astype(np.float64)
    reach = np.linalg.norm(center - middle[owner], axis=1) + radius
    return middle, np.maximum.reduceat(reach, offsets) * (1.0 + 1e-6)


def _cones(axis: Floats, spread: Floats, owner: Ints, offsets: Ints) -> tuple[Floats, Floats]:
    """Cones around cones: about the mean axis, as wide as the widest reaches; all of the sphere where there is none."""
    total = np.add.reduceat(axis, offsets)
    size = np.linalg.norm(total, axis=1)
    number = np.add.reduceat(np.ones(len(axis)), offsets)
    mean = np.divide(
        total, size[:, None], out=np.zeros_like(total), where=size[:, None] > 1e-6 * number[:, None]
    )
    apart = np.arccos(np.clip(np.einsum("ij,ij->i", axis, mean[owner]), -1.0, 1.0))
    widest = np.maximum.reduceat(apart + spread, offsets) + ANGLE_SLACK
    none = (np.abs(mean).max(axis=1) == 0.0) | (widest >= np.pi)
    return np.where(none[:, None], [0.0, 0.0, 1.0], mean), np.where(none, np.pi, widest)
