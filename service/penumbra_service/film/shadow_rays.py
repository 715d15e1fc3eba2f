"""How many of a scene's shadow rays an adaptive picture takes: by a pilot half of whose replicates took one where the scene has
more. Pure.

With k shadow rays a sample's variance is A + B / k, where B is what the choice of points on lights makes, and it costs C + D k
rays. A pilot of 1 and of K rays shows A + B, A + B / K, C + D and C + D K, and by them every k between. The one of the least
variance x cost comes to an error first (efficiency: Veach 1997, section 10.4.1). Where blocks get samples by their noise, what
an error takes is (sum of sigma_b)^2 over blocks, times the cost: so standard deviations are added up, and a rare bright sample
has no more say than its block. Rays are counted, never clocked: the choice is the same on every run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.allotment import AS_GIVEN, ShadowRays
from penumbra_scene.scene import Scene

from penumbra_service.film.allocation import BlockPilot, Saving

LEAST_REPLICATES: Final = 4
"""Halves of fewer have no variance."""
LEAST_GAIN: Final = 0.1
"""Of variance x cost: what fewer shadow rays must save. Rays are not all equally dear."""
CERTAINTY: Final = 2.0
"""Standard deviations of the saving, by its spread over blocks, that it must lie above that."""


def compared(scene: Scene, replicates: int) -> ShadowRays:
    """What hits take in the halves of a pilot's replicates; AS_GIVEN where nothing is to be decided."""
    adaptive, given = scene.adaptive, scene.integrator.shadow_rays
    if adaptive is None or adaptive.strategy != "error" or replicates < LEAST_REPLICATES or given == 1:
        return AS_GIVEN
    # As many samples with fewer rays would be a noisier picture than was asked for.
    wanted = adaptive.shadow_rays or ("at_most" if scene.stop.samples is None else "exactly")
    return (1, given) if wanted == "at_most" else AS_GIVEN


@dataclass(frozen=True)
class Comparison:
    """What a pilot's halves show."""

    given: int
    """The scene's shadow rays, at least 2."""
    one: NDArray[np.float64]
    """Of each block where hits take one: pixels x standard deviation over the signal, up to a factor."""
    all: NDArray[np.float64]
    """The same where they take as many as the scene has."""
    rays_of_one: float
    """A path."""
    rays_of_all: float

    @property
    def choice(self) -> int:
        """How many hits are to take."""
        best = min(range(1, self.given + 1), key=lambda count: float(self._effort(count).sum()))
        now = self._effort(self.given)
        saved = now - self._effort(best)
        sure = float(saved.sum()) - CERTAINTY * float(saved.std()) * saved.size**0.5
        return best if sure > (1 - (1 - LEAST_GAIN) ** 0.5) * float(now.sum()) else self.given

    def saving(self, count: int, theta: float) -> Saving:
        """What a picture of `count` takes beside one like the pilot, half of whose replicates take one."""
        noises = [float(sigma.sum()) ** 2 for sigma in (self.one, self.all)]
        mixed = sum(noises) / 2
        samples = (float(self._sigma(count).sum()) ** 2 / mixed) ** (1 / theta) if mixed > 0 else 1.0
        return Saving(samples, self._rays(count) / ((self.rays_of_one + self.rays_of_all) / 2))

    def _effort(self, count: int) -> NDArray[np.float64]:
        """Of the blocks; the square of their sum is in proportion to the rays that an error takes."""
        return np.asarray(self._rays(count) ** 0.5 * self._sigma(count))

    def _sigma(self, count: int) -> NDArray[np.float64]:
        """Of the blocks: parts that add up to the root of A + B / count."""
        share = (1 / count - 1 / self.given) / (1 - 1 / self.given)
        one, whole = float(self.one.sum()), float(self.all.sum())
        root = (share * one**2 + (1 - share) * whole**2) ** 0.5
        return (share * one * self.one + (1 - share) * whole * self.all) / root if root > 0 else self.all

    def _rays(self, count: int) -> float:
        share = (self.given - count) / (self.given - 1)
        return share * self.rays_of_one + (1 - share) * self.rays_of_all


def comparison_of(one: BlockPilot, whole: BlockPilot, given: int) -> Comparison:
    """Of the same blocks by the replicates that took one shadow ray, and by those that took the `given` ones. Both are weighed
    alike, so that what a half knows of the signal decides nothing."""
    weight = (one.weight + whole.weight) / 2
    sigma_one, sigma_all = (half.pixels * np.sqrt(weight * half.variance) for half in (one, whole))
    return Comparison(given, sigma_one, sigma_all, _rays_of(one), _rays_of(whole))


def _rays_of(pilot: BlockPilot) -> float:
    return float((pilot.pixels * pilot.cost).sum() / max(pilot.pixels.sum(), 1))
