"""Sums in planes: what is known without adding up is what adding up gives, and parts of them are the same memory."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.layout import CONSTANTS
from penumbra_kernels.sums import (
    COUNTS,
    NAMES,
    NARROW_BYTES,
    WIDE_BYTES,
    Sums,
    empty_sums,
    no_sums,
    of_replicates,
    stride_of,
)

SHAPE = (2, 3, 5)


def _drawn(seed: int, *, wide: bool = False) -> Sums:
    rng = np.random.default_rng(seed)
    sums = no_sums(SHAPE, wide=wide)
    for name in NAMES:
        sums[name] = rng.integers(0, 9, sums[name].shape)
    return sums


@pytest.mark.parametrize("wide", [False, True])
def test_both_together_have_the_sum_of_every_field(wide: bool) -> None:
    left, right = _drawn(1), _drawn(2)
    both = left.plus(right, wide=wide)
    assert both.wide is wide
    assert both.nbytes == both.size * (WIDE_BYTES if wide else NARROW_BYTES)
    for name in NAMES:
        met = left[name] | right[name] if name == "rejected_in" else left[name] + right[name]
        assert np.array_equal(both[name], met)


@pytest.mark.parametrize("name", COUNTS[:3])
def test_a_common_count_is_known_of_both_together_where_it_is_of_each(name: str) -> None:
    left, right = _drawn(1), _drawn(2)
    left[name], right[name] = 8, 4
    assert (left.common(name), right.common(name), left.plus(right, wide=False).common(name)) == (8, 4, 12)
    uneven = no_sums(SHAPE)
    uneven[name] = 4
    uneven[name][1, 2, 3] = 5
    both = left.plus(uneven, wide=False)
    assert uneven.common(name) is None
    assert both.common(name) is None
    assert both.total(name) == 12 * both.size + 1


def test_a_part_is_the_same_memory_and_has_the_bytes_of_its_own() -> None:
    whole = _drawn(3)
    part = whole[:, 1:, 2:4]
    alone = empty_sums(part.shape)
    for name in NAMES:
        assert np.array_equal(part[name], whole[name][:, 1:, 2:4])
        alone[name] = part[name]
    assert part.tobytes() == alone.tobytes()
    part["rgba"] = 7
    assert (whole["rgba"][:, 1:, 2:4] == 7).all()
    assert np.array_equal(whole[1:]["taken"], whole["taken"][1:])
    assert of_replicates([whole[:1], whole[1:]]).tobytes() == whole.tobytes()


@pytest.mark.parametrize("side", [16, 32, 64, 96, 128])
@pytest.mark.parametrize("replicates", [1, 4, 8])
def test_an_entrys_numbers_lie_in_different_sets_of_a_cache(side: int, replicates: int) -> None:
    """Of caches whose sets repeat after 4 KiB, lines of 64 bytes."""
    entries = replicates * side * side
    stride = stride_of(entries)
    assert entries <= stride < entries + 2048
    lines = {4 * stride * plane // 64 % 64 for plane in range(CONSTANTS["SUM_PLANES"])}
    assert len(lines) == CONSTANTS["SUM_PLANES"]
