"""Leases: all work once, aligned, sized by speed; lost ones again."""

from __future__ import annotations

import random
from itertools import pairwise

from penumbra_kernels.nodes import Tile
from penumbra_service.jobs.planning import (
    FIRST_LEASE_SAMPLES,
    LEASE_SECONDS,
    LEAST_SECONDS,
    LEAST_SHARE,
    MAX_GROWTH,
    MAX_LEASE_BYTES,
    LeasePlanner,
    WorkItem,
    lease_seconds,
)

TILES = [Tile(64 * i, 0, 64, 64) for i in range(40)]


def _covered(leases):  # type: ignore[no-untyped-def]
    seen: dict[Tile, list[tuple[int, int]]] = {}
    for lease in leases:
        for item in lease.items:
            assert item.first % item.count == 0
            assert item.count & (item.count - 1) == 0
            seen.setdefault(item.tile, []).append((item.first, item.count))
    return {tile: sorted(ranges) for tile, ranges in seen.items()}


def _run(planner, speeds, seed=0):  # type: ignore[no-untyped-def]
    """Devices of given samples a second work until nothing is left; their leases in order."""
    rng = random.Random(seed)
    done = []
    while True:
        device = rng.choice(sorted(speeds))
        lease = planner.take(device)
        if lease is None:
            return done
        assert planner.done(lease.number, device, lease.samples / speeds[device]) is lease
        done.append((device, lease))


def test_all_work_is_handed_out_once_whatever_the_speeds():
    planner = LeasePlanner(8, devices=2)
    planner.add(WorkItem(tile, 64, 64) for tile in TILES)
    done = _run(planner, {"slow": 1e5, "fast": 3e7})
    covered = _covered(lease for _, lease in done)
    assert set(covered) == set(TILES)
    for ranges in covered.values():
        at = 64
        for first, count in ranges:
            assert first == at
            at += count
        assert at == 128
    assert planner.idle
    assert planner.ready_samples == planner.out_samples == 0


def test_leases_grow_to_their_seconds_and_no_faster_than_stated():
    planner = LeasePlanner(8)
    planner.add(WorkItem(tile, 0, 256) for tile in TILES * 4)
    rate, previous = 1e7, None
    for _ in range(8):
        lease = planner.take("d")
        assert lease is not None
        assert lease.samples <= (FIRST_LEASE_SAMPLES if previous is None else previous * MAX_GROWTH)
        assert lease.samples / rate <= LEASE_SECONDS
        planner.done(lease.number, "d", lease.samples / rate)
        previous = max(previous or 0, lease.samples)
    assert lease.samples / rate > LEASE_SECONDS / 4


def _large_farm(items: int) -> LeasePlanner:
    planner = LeasePlanner(1, devices=10_000)
    planner.add(WorkItem(Tile(0, 0, 256, 256), 4096 * n, 4096) for n in range(items))
    return planner


def test_a_large_farm_begins_with_longer_leases():
    lease = _large_farm(2000).take("d")
    assert lease is not None
    longer = lease_seconds(10_000) / LEASE_SECONDS
    assert longer / 2 < lease.samples / FIRST_LEASE_SAMPLES <= longer


def test_a_large_farm_ends_with_longer_leases():
    speed, seconds = 8e6, lease_seconds(10_000)
    sizes = [lease.samples / speed for _, lease in _run(_large_farm(40), {"d": speed})]
    assert max(sizes) <= LEAST_SHARE * seconds, "each of the others is to have some of it"
    assert min(sizes[3:-1]) > LEAST_SHARE * seconds / 4, "once the rate is known"


def test_the_last_leases_shrink_so_that_devices_end_together():
    planner = LeasePlanner(1, devices=4)
    planner.add(WorkItem(tile, 0, 8) for tile in TILES * 12)
    speed = 1e6
    sizes = [lease.samples for _, lease in _run(planner, {"d": speed})]
    assert max(sizes) > speed
    assert max(sizes[-4:]) <= LEAST_SECONDS * speed
    assert min(sizes[:-1]) > LEAST_SECONDS * speed / 2, "short leases cost more on their way than at work"


def test_leases_stay_long_where_another_batch_follows():
    speeds, leases = {"slow": 1e5, "fast": 1e6}, {}
    batch = 64 * 64 * 64 * len(TILES)
    shortest = batch / sum(speeds.values()) / 8
    for more_follows in (True, False):
        planner = LeasePlanner(1, devices=2)
        planner.add(WorkItem(tile, 32, 32) for tile in TILES)
        _run(planner, speeds)  # their rates are known from then on
        planner.add((WorkItem(tile, 64, 64) for tile in TILES), more_follows=more_follows)
        done = _run(planner, speeds)[:-1]
        leases[more_follows] = [lease.samples / speeds[device] for device, lease in done]
    assert min(leases[True]) > shortest / 2, "work is halved until it fits"
    assert max(leases[True]) <= LEASE_SECONDS
    assert min(leases[False]) <= LEAST_SECONDS
    assert len(leases[True]) < len(leases[False])


def test_answers_stay_within_their_bytes():
    planner = LeasePlanner(8)
    planner.add(WorkItem(Tile(0, 0, 256, 256), i, 1) for i in range(64))
    for _, lease in _run(planner, {"gpu": 1e12}):
        nodes = sum(8 * item.tile.width * item.tile.height * 64 for item in lease.items)
        assert nodes <= MAX_LEASE_BYTES or len(lease.items) == 1


def test_lost_leases_go_first_and_count_their_attempts():
    planner = LeasePlanner(8)
    planner.add(WorkItem(tile, 0, 1) for tile in TILES)
    first = planner.take("a")
    assert first is not None
    second = planner.take("a")
    assert second is not None
    assert planner.lost(first.number) is first
    assert planner.lost(first.number) is None
    again = planner.take("b")
    assert again is not None
    assert again.items[0] == first.items[0]
    assert again.attempt == 2
    assert planner.redone == 1
    assert planner.done(first.number, "a", 1.0) is None


def test_dropped_leases_are_forgotten():
    planner = LeasePlanner(8)
    planner.add(WorkItem(tile, 0, 1) for tile in TILES)
    lease = planner.take("a")
    assert lease is not None
    planner.drop()
    assert planner.done(lease.number, "a", 1.0) is None
    assert planner.take("a") is None
    assert planner.lost(lease.number) is None
    assert planner.idle


def test_rates_follow_measurements():
    planner = LeasePlanner(1)
    planner.add(WorkItem(tile, 0, 1) for tile in TILES)
    assert planner.rate is None
    for device, rate in (("a", 1e6), ("b", 3e6)):
        lease = planner.take(device)
        assert lease is not None
        planner.done(lease.number, device, lease.samples / rate)
    assert planner.rate == 4e6
    assert planner.rate_of("b") == 3e6


def test_a_tile_that_starts_again_is_asked_for_once_in_all():  # type: ignore[no-untyped-def]
    """Whatever waits, is out, was given back, or is done: with what is added every sample is under way once."""
    for seed in range(50):
        rng = random.Random(seed)
        planner = LeasePlanner(4)
        planner.add(WorkItem(tile, first, 256) for tile in TILES[:4] for first in (0, 256))
        out = []
        for _ in range(rng.randrange(12)):
            lease = planner.take("a")
            if lease is None:
                break
            turn = rng.random()
            if turn < 0.4:
                planner.done(lease.number, "a", rng.choice((0.05, 2.0)))
            elif turn < 0.6:
                planner.lost(lease.number)
            else:
                out.append(lease)
        tile = TILES[rng.randrange(4)]
        before = planner.ready_samples
        added = planner.not_under_way([WorkItem(tile, 0, 512)])
        planner.add(added)
        assert planner.ready_samples == before + sum(map(planner.samples_of, added))
        ranges = [(i.first, i.end) for lease in out for i in lease.items if i.tile == tile]
        while (lease := planner.take("b")) is not None:
            ranges += [(i.first, i.end) for i in lease.items if i.tile == tile]
        ranges.sort()
        assert ranges[0][0] == 0
        assert ranges[-1][1] == 512
        assert all(a[1] == b[0] for a, b in pairwise(ranges))
