"""One tile's nodes: any order and any split give the same bits; a barrier keeps what may be dropped apart."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile, aligned_ranges
from penumbra_kernels.sums import NAMES, no_sums
from penumbra_service.film.accumulator import FoldedSums, TileAccumulator

TILE = Tile(8, 16, 3, 2)


def _splits(first: int, count: int):  # type: ignore[no-untyped-def]
    """Every way to cut an aligned range into aligned ranges."""
    yield [(first, count)]
    if count > 1:
        half = count // 2
        for left, right in itertools.product(_splits(first, half), _splits(first + half, half)):
            yield left + right


def test_every_split_and_order_of_a_range_gives_the_same_bits(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=2)
    expected = made.node(TILE, 0, 8).sums.tobytes()
    rng = np.random.default_rng(7)
    for split in _splits(0, 8):
        tile = TileAccumulator(TILE, 2)
        for first, count in rng.permutation(split):
            assert tile.add(made.node(TILE, int(first), int(count)))
        assert tile.ranges == [(0, 8)]
        assert tile.nodes[0].sums.tobytes() == expected


def _bytes(sums):  # type: ignore[no-untyped-def]
    return b"".join(field.tobytes() for field in sums.values())


def test_fold_of_an_unaligned_end_does_not_depend_on_order(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=2)
    folds = set()
    for seed in range(5):
        rng = np.random.default_rng(seed)
        tile = TileAccumulator(TILE, 2)
        for index in rng.permutation(13):
            tile.add(made.node(TILE, int(index), 1))
        assert tile.ranges == aligned_ranges(0, 13)
        folds.add(_bytes(tile.fold(13)))
    assert len(folds) == 1


def test_fold_is_the_plain_sum(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=3)
    tile = TileAccumulator(TILE, 3)
    for first, count in aligned_ranges(0, 11):
        tile.add(made.node(TILE, first, count))
    sums = tile.fold(11)
    plain = sum(made.draw(TILE, 3, i) for i in range(11))
    wide = no_sums((1, 1, 1), wide=True)
    assert {name: field.dtype for name, field in sums.items()} == {name: wide[name].dtype for name in NAMES}
    assert tile.fold_layers(11) is None
    np.testing.assert_allclose(sums["rgba"], plain, rtol=11 * 2.0**-24)
    assert sums.of_replicates(slice(1, None))["rgba"].tobytes() == sums["rgba"][1:].tobytes()


def test_counts_that_all_pixels_share_are_told_from_others():
    shape = (3, 2, 3)
    parts = [no_sums(shape, wide=True), no_sums(shape, wide=True)]
    for part, taken in zip(parts, (8, 3), strict=True):
        part["taken"] = taken
    sums = FoldedSums(parts, shape)
    assert (sums.common("taken"), sums.total("taken"), sums.total("rejected")) == (11, 11 * 3 * 2 * 3, 0)
    uneven = no_sums(shape, wide=True)
    uneven["taken"] = 3
    uneven["taken"][1, 0, 1] += 2
    other = FoldedSums([parts[0], uneven], shape)
    assert other.common("taken") is None
    assert other.total("taken") == sums.total("taken") + 2


def test_duplicates_and_parts_of_what_is_there_are_dropped(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=2)
    tile = TileAccumulator(TILE, 2)
    assert tile.add(made.node(TILE, 4, 4))
    assert not tile.add(made.node(TILE, 4, 4))
    assert not tile.add(made.node(TILE, 6, 1))
    assert tile.ranges == [(4, 4)]


def test_a_node_that_encloses_others_takes_their_place(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=2)
    tile = TileAccumulator(TILE, 2)
    tile.add(made.node(TILE, 5, 1))
    tile.add(made.node(TILE, 6, 2))
    assert tile.add(made.node(TILE, 4, 4))
    assert tile.ranges == [(4, 4)]
    assert tile.nodes[0].sums.tobytes() == made.node(TILE, 4, 4).sums.tobytes()


def test_nothing_merges_across_a_barrier_until_it_is_lifted(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=2)
    tile = TileAccumulator(TILE, 2)
    tile.set_barriers((4, 6))
    for index in range(8):
        tile.add(made.node(TILE, index, 1))
    assert tile.ranges == [(0, 4), (4, 2), (6, 2)]
    before = _bytes(tile.fold(6))
    alone = TileAccumulator(TILE, 2, [made.node(TILE, 0, 4), made.node(TILE, 4, 2)])
    assert _bytes(alone.fold(6)) == before
    tile.set_barriers((8,))
    assert tile.ranges == [(0, 8)]
    assert tile.nodes[0].sums.tobytes() == made.node(TILE, 0, 8).sums.tobytes()


def test_missing_samples_and_foreign_nodes_are_refused(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=2)
    tile = TileAccumulator(TILE, 2)
    tile.add(made.node(TILE, 0, 2))
    with pytest.raises(ValueError, match=r"do not make up \[0, 4\)"):
        tile.fold(4)
    with pytest.raises(ValueError, match="cannot go into"):
        tile.add(made.node(Tile(0, 0, 3, 2), 2, 1))
    with pytest.raises(ValueError, match="shape"):
        tile.add(samples(replicates=4).node(TILE, 2, 1))
    tile.set_barriers((6,))
    with pytest.raises(ValueError, match="barrier at 6"):
        tile.add(made.node(TILE, 4, 4))


def test_sums_beyond_256_samples_are_float64(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=1)
    tile = TileAccumulator(Tile(0, 0, 1, 1), 1)
    for first in (256, 0):
        tile.add(made.node(Tile(0, 0, 1, 1), first, 256))
    assert tile.nodes[0].sums.wide
