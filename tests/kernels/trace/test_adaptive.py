"""Pixels that take different numbers of samples: the same bits however the work is cut, and each pixel's own samples are
those that it would take alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.allotment import LEVEL_NONE, Allotment, halves, own_samples, pilot_seed
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import SumNode, Tile, merge
from penumbra_kernels.tracer import GROUP_SAMPLES, MOST_GROUP_SAMPLES, SamplePlan, Tracer, items_per_group
from penumbra_scene.adaptive import Adaptive
from penumbra_scene.scene import Scene

from tests.kernels.trace.test_bits import busy

WIDTH, HEIGHT = 24, 20
WHOLE = Tile(0, 0, WIDTH, HEIGHT)
FITTING = [*((name, level) for name in ("jittered", "sobol") for level in (0, 1, 3)), ("blue_noise", 0)]
"""Pixels of blue_noise share one sequence, which is dealt out for those that take most."""


def scene(sampler: str = "sobol", *, adaptive: bool = True, layers: tuple[str, ...] = ()) -> CompiledScene:
    plain = busy(sampler)
    film = plain.film.model_copy(update={"layers": layers})
    section = Adaptive(strategy="contrast") if adaptive else None
    return compile_scene(
        Scene.model_validate(plain.model_copy(update={"adaptive": section, "film": film}).model_dump()),
        NoAssets(),
    )


def some_levels(kept: int) -> NDArray[np.uint8]:
    """A level for each pixel, all of them there; LEVEL_NONE where there are kept samples."""
    choice = [0, 1, 2, 3, 5] + ([LEVEL_NONE] if kept else [])
    return np.random.default_rng(1).choice(np.array(choice, np.uint8), (HEIGHT, WIDTH))


def part(node: SumNode, tile: Tile) -> Any:
    return node.sums[:, tile.y : tile.y + tile.height, tile.x : tile.x + tile.width]


@pytest.mark.parametrize(("sampler", "kept"), [("sobol", 0), ("sobol", 4), ("jittered", 4)])
def test_tiles_and_leases_change_no_bit(device: Device, sampler: str, kept: int) -> None:
    levels = some_levels(kept)
    tracer = Tracer(device, scene(sampler, layers=("albedo", "normal", "depth")), SamplePlan(2))
    whole = tracer.trace(WHOLE, 0, 16, Allotment(levels, kept, 16))
    for tile in (WHOLE, Tile(0, 0, 7, 5), Tile(11, 3, 13, 17)):
        own = Allotment(levels[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width].copy(), kept, 16)
        leaves = [tracer.trace(tile, i, 1, own) for i in range(4)]
        quarters = [
            merge(merge(leaves[0], leaves[1]), merge(leaves[2], leaves[3])),
            tracer.trace(tile, 4, 4, own),
            tracer.trace(tile, 8, 4, own),
            merge(tracer.trace(tile, 12, 2, own), tracer.trace(tile, 14, 2, own)),
        ]
        cut = merge(merge(quarters[0], quarters[1]), merge(quarters[2], quarters[3]))
        assert cut.sums.tobytes() == part(whole, tile).tobytes()
        assert cut.layers is not None
        assert whole.layers is not None
        if tile == WHOLE:
            assert cut.layers.tobytes() == whole.layers.tobytes()


@pytest.mark.parametrize("kept", [0, 4])
def test_the_generic_program_gives_the_specialised_ones_bits(device: Device, kept: int) -> None:
    nodes = [
        Tracer(device, scene(), SamplePlan(2), program=program).trace(
            WHOLE, 0, 16, Allotment(some_levels(kept), kept, 16)
        )
        for program in ("specialised", "generic")
    ]
    assert nodes[0].sums.tobytes() == nodes[1].sums.tobytes()


@pytest.mark.parametrize("count", [32, 256])
@pytest.mark.parametrize("kept", [0, 4])
def test_pixels_take_as_many_samples_as_their_level_says(device: Device, kept: int, count: int) -> None:
    levels = some_levels(kept)
    sums = Tracer(device, scene(), SamplePlan(2)).trace(WHOLE, 0, count, Allotment(levels, kept, count)).sums
    expected = np.vectorize(lambda level: own_samples(count, int(level), kept))(levels)
    assert (sums["taken"] + sums["rejected"] == expected).all()


@pytest.mark.parametrize(("sampler", "level"), FITTING)
def test_a_pixels_own_samples_are_those_of_an_even_render(device: Device, sampler: str, level: int) -> None:
    """Strata too: eight samples of a sparse pixel fill eight strata."""
    own = 8
    even = Tracer(device, scene(sampler, adaptive=False), SamplePlan(2, own)).trace(WHOLE, 0, own)
    levels = np.full((HEIGHT, WIDTH), level, np.uint8)
    planned = own << level
    sparse = Tracer(device, scene(sampler), SamplePlan(2)).trace(
        WHOLE, 0, planned, Allotment(levels, 0, planned)
    )
    assert (sparse.sums["taken"] == even.sums["taken"]).all()
    assert (sparse.sums["rgba"] == even.sums["rgba"]).all()


def test_a_grid_of_refined_pixels_begins_behind_the_kept_samples(device: Device) -> None:
    """Regular: 4 points of a 2 x 2 grid, then 9 of a 3 x 3 grid, as two even renders have them."""
    tracer = Tracer(device, scene("regular"), SamplePlan(1))
    levels = np.zeros((HEIGHT, WIDTH), np.uint8)
    plan = Allotment(levels, 4, 13)
    grid = [
        Tracer(device, scene("regular", adaptive=False), SamplePlan(1, n)).trace(WHOLE, 0, n).sums
        for n in (4, 8)
    ]
    refined = Allotment(levels, 4, 12)
    assert tracer.trace(WHOLE, 0, 4, plan).sums.tobytes() == grid[0].tobytes()
    behind = [tracer.trace(WHOLE, first, 4, refined).sums["rgba"].astype(np.float64) for first in (4, 8)]
    assert behind[0] + behind[1] == pytest.approx(grid[1]["rgba"].astype(np.float64), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("sampler", ["jittered", "blue_noise"])
def test_kept_samples_are_those_that_the_pilot_took(device: Device, sampler: str) -> None:
    """Whatever is planned beyond them: a tile that is lost is rendered again with the picture's plan."""
    tracer = Tracer(device, scene(sampler), SamplePlan(2))
    levels = np.zeros((HEIGHT, WIDTH), np.uint8)
    pilot, again = (
        tracer.trace(WHOLE, 0, 4, plan).sums for plan in (Allotment(levels, 0, 4), Allotment(levels, 4, 64))
    )
    assert pilot.tobytes() == again.tobytes()


def test_a_pilot_has_random_numbers_of_its_own(device: Device) -> None:
    tracer = Tracer(device, scene(), SamplePlan(2))
    levels = np.zeros((HEIGHT, WIDTH), np.uint8)
    picture, pilot, again = (
        tracer.trace(WHOLE, 0, 4, Allotment(levels, 0, 4, pilot=own)).sums for own in (False, True, False)
    )
    surface = (picture["rgba"][..., 3] == 4) & (pilot["rgba"][..., 3] == 4)
    assert (picture["rgba"][surface, 0] != pilot["rgba"][surface, 0]).mean() > 0.99
    assert picture.tobytes() == again.tobytes()


@pytest.mark.parametrize("together", [True, False])
def test_hits_take_as_many_shadow_rays_as_an_allotment_says(device: Device, together: bool) -> None:
    """Bit for bit as in a scene that has so many, in each half of the replicates, and in what is kept others than beyond."""

    def tracer(shadow_rays: int) -> Tracer:
        plain = scene(layers=("albedo",))
        plain.params["shadow_rays"] = shadow_rays
        return Tracer(device, plain, SamplePlan(5), together=together)

    levels = some_levels(4)
    nodes = {n: tracer(n).trace(WHOLE, 0, 4, Allotment(levels, 4, 16)) for n in (1, 3)}
    beyond = tracer(2).trace(WHOLE, 4, 4, Allotment(levels, 4, 16))
    asked = Allotment(levels, 4, 16, shadow_rays=(2, 2), kept_shadow_rays=(1, 3))
    mixed = tracer(3)
    for _ in range(2):  # in any order
        kept, rest = mixed.trace(WHOLE, 0, 4, asked), mixed.trace(WHOLE, 4, 4, asked)
        assert kept.layers is not None
        for half, shadow_rays in zip(halves(5), (1, 3), strict=True):
            own = nodes[shadow_rays]
            assert own.layers is not None
            assert kept.sums[half].tobytes() == own.sums[half].tobytes()
            assert kept.layers[half].tobytes() == own.layers[half].tobytes()
        assert rest.sums.tobytes() == beyond.sums.tobytes()
    assert nodes[1].sums["rays"].sum() < nodes[3].sums["rays"].sum()
    assert mixed.trace(WHOLE, 0, 4).sums.tobytes() == nodes[3].sums.tobytes()


def test_work_items_of_a_cpu_have_samples_enough_to_fill_their_lanes() -> None:
    """Even where all of a group's pixels are those that take the fewest; and none is much longer than the rest."""
    assert items_per_group({GROUP_SAMPLES: 1}) == 1
    assert items_per_group({4: 1}) == GROUP_SAMPLES // 4
    assert items_per_group({32: 1, 4: 999}) == GROUP_SAMPLES // 4
    uneven = items_per_group({64: 500, 4: 500})
    assert uneven > GROUP_SAMPLES // 64
    assert uneven * 34 <= MOST_GROUP_SAMPLES
    assert items_per_group({0: 96, 64: 4}) > items_per_group({64: 1})  # most take nothing
    levels = np.array([[0, 3], [LEVEL_NONE, 3]], np.uint8)
    assert Allotment(levels, kept=4).samples(16, 16) == {16: 1, 2: 2, 0: 1}
    assert Allotment(levels, kept=4).samples(0, 4) == {4: 4}


def test_pilots_of_different_seeds_differ() -> None:
    seeds = [*range(64), 2**64 - 1, 2**63]
    assert len({pilot_seed(seed) for seed in seeds} | set(seeds)) == 2 * len(seeds)


@pytest.mark.parametrize("kept", [0, 1, 8])
@pytest.mark.parametrize("level", [0, 1, 4, LEVEL_NONE])
def test_own_samples_are_counted_one_by_one(level: int, kept: int) -> None:
    for end in range(70):
        taken = sum(n < kept or (level != LEVEL_NONE and n % (1 << level) == 0) for n in range(end))
        assert own_samples(end, level, kept) == taken
