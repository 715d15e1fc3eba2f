"""Which program renders first, by table; what it is predicted from, by arithmetic."""

from __future__ import annotations

import itertools
import math

import pytest
from penumbra_kernels.choice import (
    LEAST_BUILD,
    PLAIN_RATE,
    Choice,
    build_seconds,
    choose,
    is_short,
    seconds_to_come,
)

OWN, GENERIC = Choice("specialised", build_own=False), Choice("generic", build_own=False)
BOTH = Choice("generic", build_own=True)


@pytest.mark.parametrize(
    ("own", "generic", "to_come", "gain", "share", "expected"),
    [
        (0.0, 0.0, 100.0, 1.5, 0.5, OWN),  # both are there
        (0.0, 2.0, 100.0, 1.5, 0.5, OWN),
        (1.0, 2.0, 100.0, 1.5, 0.5, OWN),  # empty caches: the small one is ready first
        (2.0, 1.0, 100.0, 1.5, 0.5, BOTH),  # empty caches, and the generic one is
        (1.0, 1.0, 100.0, 1.5, 0.5, OWN),  # a tie
        (1.0, 0.0, 100.0, 1.5, 0.5, BOTH),  # the generic one is there and the work is long
        (1.0, 0.0, 0.5, 1.5, 0.5, GENERIC),  # done before the own one would be there
        (1.0, 0.0, 2.4, 1.5, 0.5, GENERIC),  # saves 1.4 / 3 s, costs half of 1 s
        (1.0, 0.0, 2.6, 1.5, 0.5, BOTH),  # saves 1.6 / 3 s
        (1.0, 0.0, 2.4, 1.5, 0.25, BOTH),  # four cores: building takes a quarter of them
        (5.0, 0.0, 5.1, 1.5, 0.0, BOTH),  # a GPU renders on while the host compiles
        (5.0, 0.0, 4.9, 1.5, 0.0, GENERIC),
        (1.0, 0.0, math.inf, 1.01, 0.5, BOTH),  # nobody knows how long
        (1.0, 0.0, math.inf, 1.0, 0.5, GENERIC),  # nothing to gain
        (1.0, 0.0, 100.0, 0.9, 0.5, GENERIC),
    ],
)
def test_what_renders_first_and_what_is_built(
    own: float, generic: float, to_come: float, gain: float, share: float, expected: Choice
) -> None:
    assert choose(own, generic, to_come, gain, share) == expected


def test_more_work_never_speaks_against_building() -> None:
    work = [0.0, 0.3, 1.0, 3.0, 10.0, 100.0, math.inf]
    for own, gain, share in itertools.product((0.1, 1.0, 8.0), (0.9, 1.02, 1.3), (0.0, 0.1, 1.0)):
        built = [choose(own, 0.0, seconds, gain, share).build_own for seconds in work]
        assert built == sorted(built)


@pytest.mark.parametrize(
    ("paths", "plain", "own", "expected"),
    [
        (0.5 * PLAIN_RATE, 1.0, 2.0, True),
        (1.5 * PLAIN_RATE, 1.0, 2.0, False),  # the other program is there before the job is done
        (1.5 * PLAIN_RATE, 0.0, 2.0, True),  # this one is in the cache
        (0.5 * PLAIN_RATE, 1.0, 0.0, False),
        (None, 0.0, 100.0, False),  # nobody knows how many
    ],
)
def test_few_paths_go_one_at_a_time(paths: float | None, plain: float, own: float, expected: bool) -> None:
    assert is_short(paths, plain, own, 1) is expected
    assert is_short(None if paths is None else 3 * paths, plain, own, 3) is expected


@pytest.mark.parametrize(
    ("planned", "done", "spent", "expected"),
    [
        (None, 3.0, 3.0, math.inf),  # an error target
        (10.0, 0.0, 0.0, 10.0),
        (10.0, 4.0, 4.0, 6.0),
        (10.0, 8.0, 8.0, 8.0),  # the tenth second may not be the last
        (1.0, 0.0, 5.0, 5.0),  # many short jobs want the same program
    ],
)
def test_what_was_asked_for_will_be_asked_for_again(
    planned: float | None, done: float, spent: float, expected: float
) -> None:
    assert seconds_to_come(planned, done, spent) == expected


@pytest.mark.parametrize("kind", ["cpu", "gpu", "accelerator"])
def test_predictions_scale_with_what_the_device_has_shown(kind: str) -> None:
    new = [build_seconds(lines, kind, ()) for lines in (0, 4600, 6600)]
    assert LEAST_BUILD == new[0] < new[1] < new[2]
    past = [(4600, 3 * new[1]), (6600, 3 * new[2])]
    assert [build_seconds(lines, kind, past) for lines in (4600, 6600)] == pytest.approx(
        [3 * new[1], 3 * new[2]]
    )
