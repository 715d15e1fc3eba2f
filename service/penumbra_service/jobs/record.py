"""What a run writes down as it goes: all that a receipt tells and a restart must know. Kept as JSON beside
the tiles."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

from penumbra_service.film.counts import PixelCounts
from penumbra_service.film.predict import Point


@dataclass
class DeviceUse:
    """What one device did for a job."""

    id: str
    name: str
    platform: str
    driver: str
    bit_class: str
    leases: int = 0
    seconds: float = 0.0
    failures: int = 0
    """Crashes, hangs and refusals under this job."""
    blocked: Literal["build", "failures", "wrong"] | None = None
    """Why it got no more of this job."""


@dataclass
class Effect:
    """An effect that the scene calls for, or does not."""

    name: str
    present: bool
    reason: str
    pointer: str | None = None


@dataclass
class ProgramUse:
    """What one program rendered on one device."""

    device: str
    program: str
    """'specialised' or 'generic'."""
    hash: str
    background_seconds: float = 0.0
    """Of building it while another one rendered."""
    leases: int = 0
    samples: int = 0
    """All pixels and replicates together."""
    first_sample: int = 0
    end: int = 0
    """Every sample that it took has an index, in its replicate, from first_sample up to before end."""


@dataclass
class Foretold:
    """The first prediction of a run."""

    at_samples: float
    samples: float
    seconds: float


@dataclass
class AdaptiveUse:
    """What a pilot decided."""

    strategy: Literal["error", "contrast"]
    mode: Literal["certified", "fast"]
    kept: int
    """Of the pilot's samples, those a replicate that are the picture's beginning."""
    pilot_samples: int
    """A pixel."""
    pilot_seconds: float
    """Of tracing."""
    theta: float | None
    """The exponent that the counts were shared out by; None where the rule asks for none."""
    levels: dict[str, int]
    """Pixels by level j, whose density is 2^-j of the largest."""
    shadow_rays: int = 0
    """That hits take; 0: nothing was decided, they take the scene's."""


@dataclass
class RunRecord:
    """A run's own account, over all of its restarts."""

    replicates: int = 1
    strata: int = 0
    deterministic: bool = False
    seconds: float = 0.0
    """Of tracing, by the clock."""
    points: list[Point] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    """Samples a replicate at which the error was looked at; the last is where the picture ends, once it
    has."""
    compile_seconds: float = 0.0
    compile_warm: bool | None = None
    """Whether every program came from a cache; None before the first."""
    build_seconds: float = 0.0
    build_warm: bool | None = None
    """Whether every device had the scene loaded already."""
    trace_seconds: float = 0.0
    """All devices' together."""
    devices: dict[str, DeviceUse] = field(default_factory=dict)
    effects: list[Effect] = field(default_factory=list)
    program_hash: str | None = None
    """Of the newest program."""
    programs: list[ProgramUse] = field(default_factory=list)
    """In the order in which they began."""
    kernel_hash: str | None = None
    redone_leases: int = 0
    resumed: int = 0
    """Times that a run went on from a snapshot."""
    checked_leases: int = 0
    """Done by two devices and compared."""
    crashes: int = 0
    foretold: Foretold | None = None
    adaptive: AdaptiveUse | None = None
    """None: no adaptive render, or its pilot has not decided yet."""
    counts: PixelCounts | None = None
    """Of the picture, once it is there."""
    warnings: list[str] = field(default_factory=list)

    @property
    def leases(self) -> int:
        """Of all devices, as far as they went into the picture."""
        return sum(use.leases for use in self.devices.values())

    @property
    def errors(self) -> dict[int, float]:
        """relmse at each of `ends`."""
        return {end: point.relmse for end, point in zip(self.ends, self.points, strict=False)}

    @property
    def bit_class(self) -> str:
        """The one class of all devices that worked, or 'mixed'."""
        classes = sorted({use.bit_class for use in self.devices.values() if use.leases})
        return classes[0] if len(classes) == 1 else ("mixed" if classes else "none")

    def use_of_program(self, device: str, program: str, text_hash: str) -> ProgramUse:
        """The account of a program on a device."""
        for use in self.programs:
            if (use.device, use.hash) == (device, text_hash):
                return use
        self.programs.append(ProgramUse(device, program, text_hash))
        return self.programs[-1]

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries and lists."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> RunRecord:
        """Back from to_json. Raises TypeError, KeyError or ValueError for anything else."""
        plain = {f.name for f in dataclasses.fields(cls)}
        if set(data) - plain:
            raise ValueError(f"unknown fields: {sorted(set(data) - plain)}")
        record = cls(**data)
        record.points = [Point(**p) for p in data["points"]]
        record.devices = {key: DeviceUse(**use) for key, use in data["devices"].items()}
        record.effects = [Effect(**e) for e in data["effects"]]
        record.programs = [ProgramUse(**use) for use in data["programs"]]
        record.foretold = Foretold(**data["foretold"]) if data["foretold"] else None
        record.adaptive = AdaptiveUse(**data["adaptive"]) if data["adaptive"] else None
        record.counts = PixelCounts(**data["counts"]) if data["counts"] else None
        return record
