"""What adaptive sampling will save, for a quote: its pilot's first round decides as the pilot of a job does, and its last tells
what that saves. Pure."""

from __future__ import annotations

from penumbra_kernels.allotment import AS_GIVEN, halves
from penumbra_kernels.nodes import Tile
from penumbra_scene.scene import Scene

from penumbra_service.film.accumulator import FoldedSums
from penumbra_service.film.allocation import BlockPilot, Saving, pilot_of, saving_of, smoothed, together
from penumbra_service.film.shadow_rays import Comparison, compared, comparison_of
from penumbra_service.film.statistics import PixelStatistics, pixel_statistics


class QuotedSaving:
    """Of one pilot, round by round. Nothing is kept where the scene's samples are not spread by error."""

    def __init__(self, scene: Scene, replicates: int) -> None:
        adaptive = scene.adaptive
        self._by_error = adaptive is not None and adaptive.strategy == "error"
        self._replicates = replicates
        self.compared = compared(scene, replicates)
        """What hits must take in the halves of the replicates."""
        self._whole: dict[int, dict[Tile, BlockPilot]] = {}
        """By the end of the round."""
        self._halves: dict[int, dict[Tile, tuple[BlockPilot, BlockPilot]]] = {}
        """Likewise, where these are compared."""

    def look(self, end: int, pixels: PixelStatistics, sums: FoldedSums) -> None:
        """A tile of the round that ends there."""
        tile = pixels.tile
        if self._by_error:
            self._whole.setdefault(end, {})[tile] = pilot_of(tile, [pixels])
        if self.compared != AS_GIVEN:
            parts = (pixel_statistics(tile, sums.of_replicates(half)) for half in halves(self._replicates))
            one, whole = (pilot_of(tile, [part]) for part in parts)
            self._halves.setdefault(end, {})[tile] = one, whole

    def saving(self, theta: float) -> Saving | None:
        """Over the blocks that were in the last round; None: nothing is spread by error."""
        if not self._whole:
            return None
        first, last = self._whole[min(self._whole)], self._whole[max(self._whole)]
        decided = together([smoothed(first[tile]) for tile in last])
        saving = saving_of(decided, together(list(last.values())), theta)
        # The job's pilot would see as much, and have all pixels take as many.
        return (saving if saving.pays else Saving()) * self._of_shadow_rays(theta)

    def _of_shadow_rays(self, theta: float) -> Saving:
        if not self._halves:
            return Saving()
        first, last = (self._comparison(end) for end in (min(self._halves), max(self._halves)))
        return last.saving(first.choice, theta)

    def _comparison(self, end: int) -> Comparison:
        pairs = [self._halves[end][tile] for tile in self._halves[max(self._halves)]]
        one, whole = (together(half) for half in zip(*pairs, strict=True))
        return comparison_of(one, whole, self.compared[1])
