"""Bits of the EXR's `Flags` channel: what a pixel's error bar may not be trusted for.

The promise of 95 +- 2 % coverage holds for pixels with no bit of UNTRUSTED; the share of the others is
reported beside it. Light that no sample ever met cannot be flagged.
"""

from __future__ import annotations

from typing import Final

HEAVY_TAILED: Final = 1
"""One replicate lies too far from the others (Grubbs' test): rare bright samples decide the mean."""
FEW_LIT: Final = 2
"""Too few of the pixel's samples carried light to judge how often they do."""
EMPTY: Final = 4
"""No sample counts in this pixel; its value is 0."""
NO_VARIANCE: Final = 8
"""Fewer than two replicates have samples, or there is only one: variance is NaN."""
DETERMINISTIC: Final = 16
"""The sampler is not random: variance is NaN, and nothing is known of the error."""
REJECTED: Final = 32
"""Some samples were NaN, infinite or negative and left out: see InvalidCount."""
BLOCK: Final = 64
"""A pixel of the same 8x8 block (aligned to the full frame) is HEAVY_TAILED or FEW_LIT."""

EFFECT_SHIFT: Final = 16
"""Bits 16-31: the effects in which rejected samples arose, as in cl/base/effects.h."""

SPREADING: Final = HEAVY_TAILED | FEW_LIT
UNTRUSTED: Final = HEAVY_TAILED | FEW_LIT | EMPTY | NO_VARIANCE | DETERMINISTIC | REJECTED | BLOCK

NAMES: Final[dict[str, int]] = {
    "heavy_tailed": HEAVY_TAILED,
    "few_lit": FEW_LIT,
    "empty": EMPTY,
    "no_variance": NO_VARIANCE,
    "deterministic": DETERMINISTIC,
    "rejected": REJECTED,
    "block": BLOCK,
}

EFFECTS: Final[dict[str, int]] = {
    "lens": 1,
    "motion": 2,
    "area_light": 4,
    "delta_light": 8,
    "environment": 16,
    "gloss": 32,
    "transmission": 64,
    "texture": 128,
    "diffuse": 256,
}
"""The EFFECT_* bits of cl/base/effects.h, before the shift."""
