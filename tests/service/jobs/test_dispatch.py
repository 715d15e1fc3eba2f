"""Whose lease next: priority, then what a second of a device is worth, then age; and scenes that are loaded."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from penumbra_service.jobs.dispatch import AFFINITY, LEAST_SECONDS, SCENES_KEPT, Dispatcher, gain_of


@dataclass(eq=False)
class Source:
    job: str
    priority: int = 0
    gain: float = 1.0
    scene: str = ""

    def __post_init__(self) -> None:
        self.scene = self.scene or self.job


def dispatcher(*sources: Source) -> Dispatcher[Source]:
    made: Dispatcher[Source] = Dispatcher()
    for source in sources:
        made.attach(source)
    return made


def test_priority_outweighs_any_gain_and_any_scene_that_is_loaded() -> None:
    calm, urgent = Source("calm", 0, gain=1e9), Source("urgent", 1, gain=1e-9)
    order = dispatcher(calm, urgent)
    order.gave("d", calm)
    assert order.order("d") == [urgent, calm]
    calm.priority = 2  # as when a person moves a job that runs
    assert order.order("d") == [calm, urgent]


def test_among_equals_the_steeper_error_goes_first_and_then_the_older() -> None:
    old, steep, young = Source("old"), Source("steep", gain=1.5), Source("young")
    assert dispatcher(old, steep, young).order() == [steep, old, young]


def test_a_loaded_scene_is_worth_a_factor_and_no_more() -> None:
    here, steeper = Source("here"), Source("steeper", gain=0.99 * AFFINITY)
    order = dispatcher(here, steeper)
    order.gave("d", here)
    assert order.order("d") == [here, steeper]
    assert order.order("other") == [steeper, here]
    steeper.gain = 1.01 * AFFINITY
    assert order.order("d") == [steeper, here]


def test_what_a_process_had_loaded_ends_with_it_and_with_newer_scenes() -> None:
    here, steeper = Source("here"), Source("steeper", gain=1.5)
    order = dispatcher(here, steeper)
    order.gave("d", here)
    order.forget("d")
    assert order.order("d") == [steeper, here]
    order.gave("d", here)
    for number in range(SCENES_KEPT):
        order.gave("d", Source(f"another {number}"))
    assert order.order("d") == [steeper, here]


def test_frames_of_a_job_go_in_order_but_a_device_stays_with_its_own() -> None:
    first, second, third = (Source("film", gain=g, scene=f"film {g}") for g in (1.0, 5.0, 9.0))
    order = dispatcher(first, second, third)
    assert order.order("idle") == [first, second, third]
    order.gave("d", second)
    assert order.order("d") == [second, first, third]
    rival = Source("rival", gain=1.5)
    order.attach(rival)
    assert order.order("idle")[0] is rival  # the job bids with its oldest frame
    assert order.order("d")[0] is second


def test_who_is_detached_is_asked_no_more() -> None:
    one, two = Source("one"), Source("two")
    order = dispatcher(one, two)
    order.detach(one)
    order.detach(one)
    assert one not in order
    assert order.order() == [two]
    order.attach(one)
    assert order.order() == [two, one]


def test_the_gain_is_the_slope_of_the_error() -> None:
    """Against a finite difference of relMSE = c t^-theta."""
    for theta in (1.0, 1.44):
        error = lambda t, theta=theta: 0.3 * t**-theta  # noqa: E731
        t, h = 7.0, 1e-4
        slope = (error(t - h) - error(t + h)) / (2 * h)
        assert abs(gain_of(error(t), theta, t) / slope - 1) < 1e-6
    assert gain_of(math.nan, 1.0, 0.0) == 1 / LEAST_SECONDS
    assert math.isfinite(gain_of(math.inf, 1.5, 0.0))


def test_equal_jobs_share_a_device_evenly_and_a_new_one_soon_gets_its_picture() -> None:
    """Errors that fall as 1/t: whoever is given a second gains less by the next."""
    jobs = [Source(str(number)) for number in range(4)]
    spent = dict.fromkeys(jobs, 0.0)
    order = dispatcher(*jobs[:3])

    def trace(seconds: float) -> None:
        source = order.order("d")[0]
        order.gave("d", source)
        spent[source] += seconds
        source.gain = gain_of(1 / spent[source], 1.0, spent[source])

    for source in jobs:
        source.gain = gain_of(math.nan, 1.0, 0.0)
    random.seed(1)
    for _ in range(300):
        trace(random.uniform(1, 2))
    shares = [spent[job] / sum(spent.values()) for job in jobs[:3]]
    # Loaded scenes count double, so a job may run ahead until its gain, 1/t^2, is half of another's.
    assert max(shares) / min(shares) < math.sqrt(AFFINITY) * 1.05
    order.attach(jobs[3])
    for _ in range(100):
        trace(1.5)
    assert spent[jobs[3]] > 100
