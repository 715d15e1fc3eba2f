"""What is known of one tile: the maximal sum nodes received so far, merged as soon as siblings meet.

Any order of arrival and any split into nodes ends in the same nodes, hence the same bits
(penumbra_kernels.nodes). Barriers are the sample counts at which a render may yet end: no node ever reaches
across one, so that what lies beyond can be dropped.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.layout import LAYERS
from penumbra_kernels.nodes import SumNode, Tile, merge, siblings
from penumbra_kernels.sums import CHANNELS, NAMES, Sums

from penumbra_service.film.scratch import Empty


class TileAccumulator:
    """Nodes of one tile in order of their first sample, no two overlapping."""

    def __init__(self, tile: Tile, replicates: int, nodes: list[SumNode] | None = None) -> None:
        self.tile = tile
        self.replicates = replicates
        self.nodes: list[SumNode] = []
        self.barriers: tuple[int, ...] = ()
        """Nodes on the two sides of one are not merged."""
        for node in nodes or []:
            self._check(node)
            self._insert(node)

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """(first sample, count) of each node."""
        return [(node.first_sample, node.sample_count) for node in self.nodes]

    @property
    def nbytes(self) -> int:
        """Bytes that the nodes' arrays take."""
        return sum(
            node.sums.nbytes + (0 if node.layers is None else node.layers.nbytes) for node in self.nodes
        )

    def add(self, node: SumNode) -> bool:
        """Take a node in; False where all of its samples were here already. Raises ValueError for one that
        does not belong to this tile, has another number of replicates, or reaches across a barrier."""
        self._check(node)
        for barrier in self.barriers:
            if node.first_sample < barrier < node.end:
                raise ValueError(
                    f"samples [{node.first_sample}, {node.end}) reach across the barrier at {barrier}"
                )
        inserted = self._insert(node)
        if inserted:
            self._merge_all()
        return inserted

    def set_barriers(self, barriers: tuple[int, ...]) -> None:
        """Take others from now on, and merge what they allow."""
        self.barriers = barriers
        self._merge_all()

    def crosses(self, sample: int) -> bool:
        """Whether a node has samples on both sides of `sample`."""
        return any(node.first_sample < sample < node.end for node in self.nodes)

    def holds(self, first: int, count: int) -> bool:
        """Whether all samples of [first, first + count) are here."""
        at = first
        for node in self.nodes:
            if node.first_sample <= at < node.end:
                at = node.end
        return at >= first + count

    def fold(self, end: int, empty: Empty = np.empty) -> FoldedSums:
        """Sums over samples [0, end), in arrays that `empty` makes. Samples from `end` on are left out. Raises ValueError
        where some are missing."""
        return FoldedSums([node.sums for node in self._parts(end)], self._shape, empty)

    def fold_layers(self, end: int) -> NDArray[Any] | None:
        """The same of LAYERS, (replicates, height, width); None where nodes have none."""
        return _layers_of(self._parts(end))

    def _parts(self, end: int) -> list[SumNode]:
        if not self.holds(0, end) or self.crosses(end):
            raise ValueError(f"tile {self.tile} holds samples {self.ranges}, which do not make up [0, {end})")
        return [node for node in self.nodes if node.end <= end]

    @property
    def _shape(self) -> tuple[int, int, int]:
        return (self.replicates, self.tile.height, self.tile.width)

    def _check(self, node: SumNode) -> None:
        if node.tile != self.tile:
            raise ValueError(f"a node of {node.tile} cannot go into {self.tile}")
        if node.sums.shape != self._shape:
            raise ValueError(f"sums of shape {node.sums.shape} where {self._shape} is due")

    def _insert(self, node: SumNode) -> bool:
        """Put a node in its place. Aligned power-of-two ranges are nested or disjoint: one that lies inside
        another is a duplicate; one that encloses others has the same bits as they would have, and takes their
        place."""
        at = bisect_left([n.first_sample for n in self.nodes], node.first_sample)
        if at > 0 and self.nodes[at - 1].end > node.first_sample:
            return False
        if at < len(self.nodes):
            there = self.nodes[at]
            if there.first_sample == node.first_sample and there.sample_count >= node.sample_count:
                return False
        stop = at
        while stop < len(self.nodes) and self.nodes[stop].first_sample < node.end:
            stop += 1
        self.nodes[at:stop] = [node]
        return True

    def _merge_all(self) -> None:
        """Merge siblings until none are left: one pass with a stack, as carries run in binary addition."""
        merged: list[SumNode] = []
        for node in self.nodes:
            while merged and self._may_merge(merged[-1], node):
                node = merge(merged.pop(), node)
            merged.append(node)
        self.nodes = merged

    def _may_merge(self, left: SumNode, right: SumNode) -> bool:
        if not siblings(left, right):
            return False
        return not any(left.first_sample < barrier < right.end for barrier in self.barriers)


class FoldedSums(Mapping[str, NDArray[Any]]):
    """The fields of wide Sums, each (replicates, height, width): nodes added in index order. A field is added up when it is
    first asked for, since a look at a picture needs few of them."""

    def __init__(self, parts: Sequence[Sums], shape: tuple[int, int, int], empty: Empty = np.empty) -> None:
        self.shape = shape
        self._parts = parts
        self._empty = empty
        self._fields: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._fields:
            self._fields[name] = self.planes().transpose(1, 2, 3, 0) if name == "rgba" else self._counts(name)
        return self._fields[name]

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)

    def of_replicates(self, chosen: slice) -> FoldedSums:
        """Those of some replicates alone."""
        count = len(range(*chosen.indices(self.shape[0])))
        return FoldedSums([part[chosen] for part in self._parts], (count, *self.shape[1:]), self._empty)

    def planes(self) -> NDArray[np.float64]:
        """(channels, replicates, height, width), to be written over."""
        planes = self._empty((CHANNELS, *self.shape))
        if not self._parts:
            planes[...] = 0.0
        for number, part in enumerate(self._parts):
            if number == 0:
                planes[...] = part.planes
            else:
                planes += part.planes
        return planes

    def common(self, name: str) -> int | None:
        """The count that every pixel has in every replicate, None where they differ in a node: known without adding any up."""
        counts = [part.common(name) for part in self._parts]
        return None if None in counts else sum(filter(None, counts))

    def total(self, name: str) -> int:
        """A count over all pixels and replicates."""
        return sum(part.total(name) for part in self._parts)

    def _counts(self, name: str) -> NDArray[Any]:
        total: NDArray[Any] = np.zeros(self.shape, np.uint64 if name == "rays" else np.uint32)
        for part in self._parts:
            if name == "rejected_in":
                total |= part[name]
            else:
                total += part[name]
        return total


def _layers_of(parts: list[SumNode]) -> NDArray[Any] | None:
    if not parts or any(part.layers is None for part in parts):
        return None
    assert parts[0].layers is not None
    total: NDArray[Any] = np.zeros(parts[0].layers.shape, LAYERS)
    total["object_id"] = parts[0].layers["object_id"]
    for part in parts:
        assert part.layers is not None
        total["albedo_depth"] += part.layers["albedo_depth"]
        total["normal"] += part.layers["normal"]
    return total
