"""How many shadow rays pay, told by pilots whose noise and cost are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.allotment import AS_GIVEN
from penumbra_scene.scene import Scene
from penumbra_service.film.allocation import BlockPilot
from penumbra_service.film.shadow_rays import Comparison, compared, comparison_of

GIVEN = 16
BLOCKS = (40, 50)


def pilot(
    shadow_rays: int, rest: float, lights: float, camera: float, ray: float, seed: int = 0
) -> BlockPilot:
    """Of blocks whose samples have variance rest + lights / k and take camera + ray k rays, as a pilot of a dozen degrees of
    freedom sees them; seed 0: exactly."""
    brightness = np.random.default_rng(7).lognormal(0, 1, BLOCKS)
    chance = np.ones(BLOCKS) if seed == 0 else np.random.default_rng(seed).chisquare(12, BLOCKS) / 12
    variance = (rest + lights / shadow_rays) * brightness * chance
    return BlockPilot(
        np.full(BLOCKS, 4.0), variance, 1 / brightness, np.full(BLOCKS, camera + ray * shadow_rays)
    )


def comparison(*model: float, seeds: tuple[int, int] = (0, 0)) -> Comparison:
    one, whole = (pilot(k, *model, seed) for k, seed in zip((1, GIVEN), seeds, strict=True))
    return comparison_of(one, whole, GIVEN)


@pytest.mark.parametrize("lights", [0.0, 0.05, 0.3, 1.0, 3.0, 10.0, 1000.0])
@pytest.mark.parametrize("ray", [0.1, 1.0, 4.0])
def test_the_choice_has_the_least_variance_times_cost(lights: float, ray: float) -> None:
    """Found by trying all; the scene's own number stays where it is within a tenth of that."""
    product = {k: (1 + lights / k) * (3 + ray * k) for k in range(1, GIVEN + 1)}
    best = min(product, key=lambda k: product[k])
    expected = best if product[best] < 0.9 * product[GIVEN] else GIVEN
    assert comparison(1.0, lights, 3.0, ray).choice == expected


def test_a_few_blocks_rare_bright_samples_decide_nothing() -> None:
    """Three of 2,000 blocks with 10^5 times the noise, in either half: nearly all of its variance, and the choice is one ray
    off at most."""
    for lights in (0.05, 50.0):
        quiet = comparison(1.0, lights, 3.0, 1.0, seeds=(1, 2))
        for half in ("one", "all"):
            sigma = getattr(quiet, half).copy()
            sigma.flat[[3, 500, 1999]] *= 10**2.5
            loud = Comparison(**{**vars(quiet), half: sigma})
            assert abs(loud.choice - quiet.choice) <= 1


@pytest.mark.parametrize("seed", range(20))
def test_chance_does_not_decide(seed: int) -> None:
    """One ray and sixteen are worth as much, and a number between is better."""
    camera = 15 / ((1 + 5) / (1 + 5 / 16) - 1) - 1  # 1 and 16 rays have one product
    product = {k: (1 + 5 / k) * (camera + k) for k in range(1, GIVEN + 1)}
    assert product[1] == pytest.approx(product[GIVEN])
    chosen = comparison(1.0, 5.0, camera, 1.0, seeds=(2 * seed + 1, 2 * seed + 2)).choice
    assert product[chosen] <= product[GIVEN]
    assert product[chosen] < 1.05 * min(product.values()) or chosen == GIVEN


def test_what_a_choice_saves_beside_the_pilot() -> None:
    """Half of whose samples have variance 3 and 4 rays, the other half 1.125 and 19; theta 1.25."""
    found = comparison(1.0, 2.0, 3.0, 1.0)
    mean, rays = (3 + 1.125) / 2, (4 + 19) / 2
    for k in (1, 2, 5, GIVEN):
        saving = found.saving(k, 1.25)
        assert saving.samples == pytest.approx(((1 + 2 / k) / mean) ** (1 / 1.25))
        assert saving.cost == pytest.approx((3 + k) / rays)


def test_a_black_picture_decides_nothing() -> None:
    black = comparison(0.0, 0.0, 1.0, 0.0)
    assert black.choice == GIVEN
    assert black.saving(GIVEN, 1.0).samples == 1.0


@pytest.mark.parametrize(
    ("sections", "expected"),
    [
        ({}, (1, 4)),
        ({"stop": {"seconds": 3}}, (1, 4)),
        ({"stop": {"samples": 64, "relative_error": 0.1}}, AS_GIVEN),
        ({"stop": {"samples": 64}, "adaptive": {"shadow_rays": "at_most"}}, (1, 4)),
        ({"adaptive": {"shadow_rays": "exactly"}}, AS_GIVEN),
        ({"adaptive": {"strategy": "contrast"}}, AS_GIVEN),
        ({"adaptive": None}, AS_GIVEN),
        ({"integrator": {"shadow_rays": 1}}, AS_GIVEN),
    ],
)
def test_a_pilot_compares_where_fewer_rays_can_be_no_worse_picture(sections, expected):  # type: ignore[no-untyped-def]
    base = {
        "version": 1,
        "camera": {"type": "perspective"},
        "integrator": {"shadow_rays": 4},
        "adaptive": {},
        "stop": {"relative_error": 0.1},
    }
    scene = Scene.model_validate({**base, **sections})
    assert compared(scene, 4) == expected
    assert compared(scene, 3) == AS_GIVEN
