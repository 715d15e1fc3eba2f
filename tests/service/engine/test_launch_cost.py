"""A pilot's short leases tell what samples cost in a picture's long ones."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_service.engine.launch_cost import LEAST_SHARE, Cost, Work, fit, joined, unsteadiness

NODE, SAMPLE = 2e-4, 2.5e-8


def rounds(counts: tuple[int, ...], node: float = NODE, sample: float = SAMPLE) -> list[Work]:
    """125 blocks of 64 pixels and 4 replicates in each, the first 1.5 times as dear as the others."""
    found = []
    for i, count in enumerate(counts):
        samples = 125 * 64 * 4 * count
        seconds = node * 125 + sample * samples
        found.append(Work(125, samples, seconds * (1.5 if i == 0 else 1.0)))
    return found


def test_launches_and_samples_are_told_apart() -> None:
    cost = fit(rounds((4, 4, 8, 16)))
    assert cost.sample == pytest.approx(SAMPLE)
    assert cost.node == pytest.approx(NODE)
    lease = Work(40, 10**6, NODE * 40 + 3e-8 * 10**6)
    assert cost.seconds_per_sample(lease) == pytest.approx(3e-8)


@pytest.mark.parametrize("counts", [(4,), (4, 4), (4, 8), (4, 8, 8)])
def test_where_they_cannot_be_samples_have_taken_it_all(counts: tuple[int, ...]) -> None:
    newest = rounds(counts)[-1]
    assert fit(rounds(counts)) == Cost(0.0, pytest.approx(newest.seconds / newest.samples))


def test_no_launch_costs_less_than_nothing() -> None:
    slower = [Work(125, n, 1e-8 * n**1.2) for n in (10**5, 10**5, 2 * 10**5, 4 * 10**5)]
    cost = fit(slower)
    assert cost.node == pytest.approx(0.0, abs=1e-12)
    assert cost.sample == pytest.approx(slower[-1].seconds / slower[-1].samples)


def test_samples_cost_something_whatever_was_measured() -> None:
    odd = [Work(125, 10**5, 0.5), Work(125, 10**5, 0.5), Work(125, 4 * 10**5, 0.4)]
    assert fit(odd).sample == pytest.approx(LEAST_SHARE * 0.4 / (4 * 10**5))


def test_leases_of_a_round_are_one() -> None:
    assert joined([Work(2, 30, 0.5), Work(3, 50, 0.25)]) == Work(5, 80, 0.75)


def test_an_unsteady_machine_makes_a_rate_less_certain() -> None:
    """Oracle: rounds whose seconds deviate by 20 % at random, 400 times over."""
    random = np.random.default_rng(7)
    counts = (4, 4, 8, 16, 32, 64, 128)
    assert unsteadiness(rounds(counts)) == pytest.approx(0.0, abs=1e-9)
    told = []
    for _ in range(400):
        noisy = [Work(w.nodes, w.samples, w.seconds * random.normal(1, 0.2)) for w in rounds(counts)]
        told.append(unsteadiness(noisy))
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(0.2, rel=0.15)
    assert unsteadiness(rounds((4, 8, 16))) == 0.0, "two rounds that count, and two costs"
