"""A day of a large farm, simulated, and written into docs/farm.md: `python bench/farm_simulation.py [--workers 10000]
[--hours 24] [--no-page]`.

It drives the planner of the service itself (jobs.dispatch, jobs.planning) with workers of uneven speed that die and come
back, jobs that arrive at random, and an urgent job every hour; only devices, network and time are made up. It prints what
of the workers' time was used, what was done again after deaths, and how long urgent jobs took against the time that all
living workers together need for them.

Assumptions: speeds are lognormal (sigma 0.6, mean 8 million pixel samples a second); a worker lives 6 h on average,
is missed after 10 s and replaced after 5 min on average (all exponential); a scene takes 10 s to load; what takes an answer's
place is there 50 ms later; 8 jobs share the farm, the others wait. Pictures have tiles of 256 x 256 pixels and 4,096 samples in
each of 4 replicates; some tiles cost twice as much as others.
"""

from __future__ import annotations

import argparse
import gc
import heapq
import itertools
import json
import math
import random
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from block import processor, table, write_block
from penumbra_kernels.nodes import Tile
from penumbra_service.jobs.dispatch import IN_FLIGHT, SCENES_KEPT, Dispatcher, gain_of
from penumbra_service.jobs.planning import LeasePlanner, PlannedLease, WorkItem, lease_seconds

RESULTS: Final = Path(__file__).with_name("results") / "farm_simulation.json"
SPEED: Final = 8e6
SPREAD: Final = 0.6
LIFE_SECONDS: Final = 6 * 3600.0
MISSED_SECONDS: Final = 10.0
AWAY_SECONDS: Final = 300.0
LOAD_SECONDS: Final = 10.0
TURN_SECONDS: Final = 0.05
AT_ONCE: Final = 8
URGENT_EVERY: Final = 3600.0
REPLICATES: Final = 4
SIDE: Final = 256
SAMPLES: Final = 4096
"""Of a pixel, in each replicate."""
JOB_SHARE: Final = 1 / 48
"""Of the farm's day that a job takes on average."""
URGENT_SHARE: Final = 1 / 1440
LOAD_FACTOR: Final = 1.2
"""Work that arrives over work that can be done: the queue never runs dry."""


@dataclass(eq=False, slots=True)
class Job:
    """Implements jobs.dispatch.Bidder. Work is in pixel samples, all replicates together."""

    job: str
    priority: int
    arrived: float
    planner: LeasePlanner
    total: int
    left: int
    device_seconds: float = 0.0
    first_lease: float | None = None
    finished: float | None = None
    gain: float = gain_of(math.nan, 1.0, 0.0)

    @property
    def scene(self) -> str:
        return self.job

    def delivered(self, samples: int, seconds: float) -> None:
        """A lease is done."""
        self.device_seconds += seconds
        self.left -= samples
        relmse = SIDE * SIDE / (self.total - self.left)  # falls as 1/n from any constant
        self.gain = gain_of(relmse, 1.0, self.device_seconds)


@dataclass(eq=False, slots=True)
class Worker:
    """A device: leases in order, of which it works on the first."""

    name: str
    speed: float
    born: float = 0.0
    alive: bool = True
    life: int = 0
    """Counts its lives: events of an earlier one are void."""
    held: deque[tuple[Job, PlannedLease, float]] = field(default_factory=deque)
    """With the seconds that each traces."""
    scenes: deque[str] = field(default_factory=lambda: deque(maxlen=SCENES_KEPT))
    fed: float = 0.0
    """When the lease that it was given last is there."""
    began: float = 0.0
    """When it turned to its present lease."""
    loading: float = 0.0
    """Seconds that the lease's scene takes to load."""


@dataclass(slots=True)
class Account:
    """Worker-seconds, but for the counts."""

    alive: float = 0.0
    traced: float = 0.0
    loaded: float = 0.0
    wasted: float = 0.0
    """Of leases that died with their worker."""
    leases: int = 0
    redone: int = 0
    deaths: int = 0


Event = Callable[[float, object, int], None]
"""Something happens: when, to whom, and in which of its lives."""


class Farm:
    """One simulation. Call `run` once."""

    def __init__(self, workers: int, hours: float, seed: int = 1) -> None:
        self.end = hours * 3600.0
        self.account = Account()
        self.finished: list[Job] = []
        self._random = random.Random(seed)
        self._dispatcher: Dispatcher[Job] = Dispatcher()
        self._waiting: list[tuple[int, float, int, Job]] = []
        self._running: list[Job] = []
        self._events: list[tuple[float, int, Event, object, int]] = []
        self._order = itertools.count()
        self._starving: dict[Worker, None] = {}
        mean = math.exp(SPREAD**2 / 2)
        self.workers = [
            Worker(f"w{n}", SPEED * math.exp(self._random.gauss(0, SPREAD)) / mean) for n in range(workers)
        ]
        self.capacity = sum(worker.speed for worker in self.workers)
        self._numbers = itertools.count()

    def run(self) -> None:
        """Until the end of the day."""
        for worker in self.workers:
            self._at(self._random.expovariate(1 / LIFE_SECONDS), self._dies, worker, 0)
            self._at(0.0, self._asks, worker, 0)
        for moment in self._arrivals():
            self._at(moment, self._arrives, 0)
        for moment in _every(URGENT_EVERY, self.end):
            self._at(moment, self._arrives, 1)
        while self._events and self._events[0][0] <= self.end:
            now, _, happen, subject, life = heapq.heappop(self._events)
            happen(now, subject, life)
        for worker in self.workers:
            if worker.alive:
                self.account.alive += self.end - worker.born

    def _at(self, moment: float, happen: Event, subject: object, life: int = 0) -> None:
        heapq.heappush(self._events, (moment, next(self._order), happen, subject, life))

    def _arrivals(self) -> Iterator[float]:
        gap = JOB_SHARE * 86400 / LOAD_FACTOR
        moment = 0.0
        for _ in range(AT_ONCE):
            yield 0.0
        while (moment := moment + self._random.expovariate(1 / gap)) < self.end:
            yield moment

    def _arrives(self, now: float, priority: object, _life: int) -> None:
        share = URGENT_SHARE if priority else JOB_SHARE * self._random.uniform(0.3, 1.7)
        tiles = max(round(self.capacity * 86400 * share / (REPLICATES * SIDE * SIDE * SAMPLES)), 1)
        planner = LeasePlanner(REPLICATES, len(self.workers))
        planner.add(WorkItem(Tile(n * SIDE, 0, SIDE, SIDE), 0, SAMPLES) for n in range(tiles))
        total = planner.ready_samples
        job = Job(f"job {next(self._numbers)}", int(bool(priority)), now, planner, total, total)
        heapq.heappush(self._waiting, (-job.priority, now, next(self._order), job))
        self._admit(now)

    def _admit(self, now: float) -> None:
        """Jobs begin in the order of the queue; an urgent one makes the least urgent wait (its leases run out)."""
        while self._waiting and (len(self._running) < AT_ONCE or -self._waiting[0][0] > 0):
            *_, job = heapq.heappop(self._waiting)
            self._running.append(job)
            self._dispatcher.attach(job)
        for worker in list(self._starving):
            self._feed(now, worker)

    def _asks(self, now: float, subject: object, life: int) -> None:
        assert isinstance(subject, Worker)
        if subject.life == life and subject.alive:
            self._feed(now, subject)

    def _feed(self, now: float, worker: Worker) -> None:
        """Fill its places."""
        self._starving.pop(worker, None)
        while len(worker.held) < IN_FLIGHT:
            if not self._feed_one(now, worker):
                self._starving[worker] = None
                return

    def _feed_one(self, now: float, worker: Worker) -> bool:
        for job in self._dispatcher.order(worker.name):
            lease = job.planner.take(worker.name)
            if lease is None:
                continue
            self._dispatcher.gave(worker.name, job)
            self.account.leases += 1
            self.account.redone += lease.attempt > 1
            job.first_lease = now if job.first_lease is None else job.first_lease
            cost = 0.67 + 0.66 * (lease.items[0].tile.x * 0.618 / SIDE % 1.0)
            worker.held.append((job, lease, lease.samples * cost / worker.speed))
            if len(worker.held) == 1:
                self._begin(max(now, worker.fed), worker)
            return True
        return False

    def _begin(self, now: float, worker: Worker) -> None:
        job, _, seconds = worker.held[0]
        worker.loading = LOAD_SECONDS
        if job.scene in worker.scenes:
            worker.scenes.remove(job.scene)
            worker.loading = 0.0
        worker.scenes.append(job.scene)
        worker.began = now
        self._at(now + worker.loading + seconds, self._answers, worker, worker.life)

    def _answers(self, now: float, subject: object, life: int) -> None:
        worker = subject
        assert isinstance(worker, Worker)
        if worker.life != life:
            return
        job, lease, seconds = worker.held.popleft()
        self.account.traced += seconds
        self.account.loaded += worker.loading
        job.planner.done(lease.number, worker.name, seconds)
        job.delivered(lease.samples, seconds)
        if worker.held:
            self._begin(max(now, worker.fed), worker)
        if job.left == 0:
            self._end(now, job)
        worker.fed = now + TURN_SECONDS
        self._feed(now, worker)

    def _end(self, now: float, job: Job) -> None:
        job.finished = now
        self.finished.append(job)
        self._running.remove(job)
        self._dispatcher.detach(job)
        self._admit(now)

    def _dies(self, now: float, subject: object, _life: int) -> None:
        worker = subject
        assert isinstance(worker, Worker)
        self.account.deaths += 1
        self.account.alive += now - worker.born
        worker.alive = False
        worker.life += 1
        if worker.held:
            self.account.wasted += max(now - worker.began, 0.0)
        self._starving.pop(worker, None)
        self._at(now + MISSED_SECONDS, self._missed, worker)
        self._at(now + MISSED_SECONDS + self._random.expovariate(1 / AWAY_SECONDS), self._returns, worker)

    def _missed(self, now: float, subject: object, _life: int) -> None:
        """Its leases are issued again."""
        worker = subject
        assert isinstance(worker, Worker)
        for job, lease, _ in worker.held:
            job.planner.lost(lease.number)
        worker.held.clear()
        worker.scenes.clear()
        self._dispatcher.forget(worker.name)
        for other in list(self._starving):
            self._feed(now, other)

    def _returns(self, now: float, subject: object, _life: int) -> None:
        worker = subject
        assert isinstance(worker, Worker)
        worker.alive, worker.born = True, now
        self._at(now + self._random.expovariate(1 / LIFE_SECONDS), self._dies, worker)
        self._feed(now, worker)


def _every(step: float, end: float) -> Iterator[float]:
    moment = step / 2
    while moment < end:
        yield moment
        moment += step


def report(farm: Farm) -> dict[str, Any]:
    """What came of it: shares of the living workers' time, counts, and seconds of urgent jobs."""
    account = farm.account
    urgent = [job for job in farm.finished if job.priority]
    latency = sorted(job.finished - job.arrived for job in urgent if job.finished is not None)
    first = [job.first_lease - job.arrived for job in urgent if job.first_lease is not None]
    return {
        "workers": len(farm.workers),
        "hours": farm.end / 3600,
        "lease_seconds": lease_seconds(len(farm.workers)),
        "leases": account.leases,
        "deaths": account.deaths,
        "traced": account.traced / account.alive,
        "loaded": account.loaded / account.alive,
        "died": account.wasted / account.alive,
        "redone": account.redone,
        "jobs": len(farm.finished),
        "urgent": len(urgent),
        "first_lease_seconds": max(first, default=math.nan),
        "urgent_seconds_median": latency[len(latency) // 2] if latency else math.nan,
        "urgent_seconds_longest": latency[-1] if latency else math.nan,
        "urgent_seconds_of_all_workers": statistics.fmean(j.total / farm.capacity for j in urgent)
        if urgent
        else math.nan,
    }


def page(told: dict[str, Any]) -> str:
    """What docs/farm.md says of it."""
    rows = [
        ("workers, leases of", f"{told['workers']:,}, {told['lease_seconds']:g} s"),
        ("simulated", f"{told['hours']:g} h: {told['leases']:,} leases, {told['jobs']} jobs done"),
        ("of the living workers' time traced what counts", f"{told['traced']:.2%}"),
        ("loaded scenes", f"{told['loaded']:.2%}"),
        (f"died with one of {told['deaths']:,} workers", f"{told['died']:.3%}"),
        ("leases done again", f"{told['redone']:,} ({told['redone'] / told['leases']:.2%})"),
        (
            f"first lease of an urgent job ({told['urgent']} of them)",
            f"after {told['first_lease_seconds']:.2f} s at most",
        ),
        (
            "an urgent job was done",
            f"after {told['urgent_seconds_median']:.0f} s (median), {told['urgent_seconds_longest']:.0f} s (longest); all "
            f"workers together need {told['urgent_seconds_of_all_workers']:.0f} s",
        ),
        ("one core of this machine took", f"{told['core_seconds']:.0f} s ({told['processor']})"),
    ]
    return table(("what", "measured"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=10_000)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-page", action="store_true", help="print the numbers and write nothing")
    options = parser.parse_args()
    began = time.process_time()
    gc.disable()  # millions of objects that live for a day, and no cycles: looking for them takes a third of the time
    farm = Farm(options.workers, options.hours, options.seed)
    farm.run()
    told = {**report(farm), "core_seconds": time.process_time() - began, "processor": processor()}
    print(json.dumps(told, indent=1))
    if not options.no_page:
        RESULTS.write_text(json.dumps(told, indent=1) + "\n")
        write_block("farmsim", page(told))


if __name__ == "__main__":
    main()
