"""What a pilot found out, for a quote to be made of."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from penumbra_service.film.allocation import Saving
from penumbra_service.film.predict import Point
from penumbra_service.film.replicates import Layout
from penumbra_service.jobs.record import DeviceUse


@dataclass
class PilotResult:
    """What came of it. Seconds of points are those of the whole picture."""

    layout: Layout
    points: list[Point] = field(default_factory=list)
    blocks: int = 0
    blocks_in_picture: int = 0
    pixels: int = 0
    seconds: float = 0.0
    seconds_per_sample: float = math.nan
    """Of one sample in every pixel of the picture."""
    rate_deviation: float = 0.0
    """Relative standard deviation of `seconds_per_sample`, from its spread over leases."""
    saving: Saving | None = None
    """Of a scene that spreads its samples by error."""
    flagged_share: float = 0.0
    rejected_share: float = 0.0
    compile_seconds: float = 0.0
    compile_warm: bool = True
    build_seconds: float = 0.0
    build_warm: bool = True
    devices: dict[str, DeviceUse] = field(default_factory=dict)
