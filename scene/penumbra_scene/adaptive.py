"""Adaptive supersampling: more samples where they are needed, by a plan that a pilot decides once."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from penumbra_scene import limits
from penumbra_scene.base import Model, NotBoolean, error_at

DEFAULT_PILOT: Final = {"error": 8, "contrast": 4}
"""Samples a pixel that decide, by strategy."""
DEFAULT_THRESHOLD: Final = 0.1


class Adaptive(Model):
    """How the samples are spread over the picture; `stop.samples` is then the mean over its pixels."""

    strategy: Literal["error", "contrast", "off"] = "error"
    """error: by 2 x 2 blocks, where more samples lower the picture's error most; contrast: only where two
    neighbouring pixels differ by more than the threshold; off: the same number everywhere."""
    mode: Literal["certified", "fast"] | None = None
    """Of `error`. certified (default): the samples that decide are dropped, so that picture and error bars
    stay unbiased; fast: they are kept, and the result is labelled biased."""
    pilot_samples: Annotated[int, Field(ge=1, le=limits.MAX_PILOT_SAMPLES), NotBoolean] | None = None
    """Samples a pixel that decide, rounded up to a power of two in each replicate. Default 8, and up to 1/24
    of what the picture is expected to take; for `contrast`, whose picture begins with them, 4."""
    shadow_rays: Literal["at_most", "exactly"] | None = None
    """Of `error`. at_most: hits take fewer shadow rays than `integrator.shadow_rays` where the pilot tells that the
    picture comes to its error sooner; exactly: that many. Default at_most, but exactly where `stop.samples` is
    given: as many samples with fewer rays would be a noisier picture."""
    threshold: Annotated[float, Field(strict=True, gt=0, lt=1)] | None = None
    """Of `contrast`: |a - b| / (a + b + 0.01) of two neighbouring pixels, in R, G or B. Default 0.1."""

    @model_validator(mode="after")
    def _agree(self) -> Adaptive:
        if self.strategy != "error" and self.mode is not None:
            message = f"{self.strategy!r} has no modes" + (
                ": it keeps the samples that decide" if self.strategy == "contrast" else ""
            )
            raise error_at("/mode", message, 'null, or the strategy "error"')
        if self.strategy != "error" and self.shadow_rays is not None:
            message = f"only `error` decides on shadow rays, {self.strategy!r} does not"
            raise error_at("/shadow_rays", message, 'null, or the strategy "error"')
        if self.strategy != "contrast" and self.threshold is not None:
            raise error_at(
                "/threshold", "only `contrast` has a threshold", 'null, or the strategy "contrast"'
            )
        return self

    @property
    def biased(self) -> bool:
        """Whether the samples that decide stay in the picture."""
        return self.strategy == "contrast" or self.mode == "fast"

    @property
    def pilot(self) -> int:
        """Samples a pixel that decide, as asked or by default."""
        return self.pilot_samples or DEFAULT_PILOT[self.strategy]

    @property
    def contrast(self) -> float:
        """The threshold, as asked or by default."""
        return self.threshold or DEFAULT_THRESHOLD


def in_force(adaptive: Adaptive | None) -> Adaptive | None:
    """The section, or None where it turns adaptive sampling off."""
    return None if adaptive is None or adaptive.strategy == "off" else adaptive
