"""What programs have cost on a device, kept beside the program cache: what choice.py predicts from.

One small JSON file for each device and driver. Processes may write at the same time: the last one wins, and what is lost is one
number among many. A broken file is an empty one.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import TYPE_CHECKING, Any, Final

from penumbra_kernels import cache
from penumbra_kernels.choice import GAIN, build_seconds

if TYPE_CHECKING:
    from penumbra_kernels.device import DeviceInfo

KEPT: Final = 32
"""Newest numbers of each sort."""


@dataclass(frozen=True)
class Past:
    """Of one device and driver; the newest last."""

    builds: tuple[tuple[int, float], ...] = ()
    """(active lines, seconds) of programs that were built."""
    gains: tuple[float, ...] = ()
    """Speed of a scene's own program over the generic one's, on the same samples."""
    rates: tuple[float, ...] = ()
    """Samples a second of scenes."""
    spent: tuple[tuple[str, float], ...] = ()
    """(SHA-256 of a program's text, seconds that the generic program has rendered in its place)."""

    def build_seconds(self, lines: int, kind: str) -> float:
        """Predicted for a program of so many active lines."""
        return build_seconds(lines, kind, self.builds)

    def spent_for(self, program: str) -> float:
        """Seconds that the generic program has rendered in the place of this one."""
        return dict(self.spent).get(program, 0.0)

    @property
    def gain(self) -> float:
        """Expected of a scene's own program."""
        return median(self.gains) if self.gains else GAIN

    @property
    def rate(self) -> float | None:
        """Samples a second to be expected of a scene."""
        return median(self.rates) if self.rates else None


class History:
    """The past of one device, on disk."""

    def __init__(self, info: DeviceInfo) -> None:
        name = hashlib.sha256(f"{info.platform}|{info.bit_class}".encode()).hexdigest()
        self._path = cache.folder() / "history" / f"{name}.json"

    def read(self) -> Past:
        """Empty where nothing is known."""
        try:
            return _parse(json.loads(self._path.read_bytes()))
        except (OSError, ValueError, TypeError, KeyError):
            return Past()

    def add_spent(self, program: str, seconds: float) -> None:
        """The generic program has rendered in the place of this one."""
        past = self.read()
        spent = dict(past.spent)
        total = spent.pop(program, 0.0) + seconds
        self._write(replace(past, spent=(*spent.items(), (program, total))[-KEPT:]))

    def add_build(self, lines: int, seconds: float) -> None:
        """A program was built."""
        past = self.read()
        self._write(replace(past, builds=(*past.builds, (lines, seconds))[-KEPT:]))

    def add_gain(self, gain: float) -> None:
        """A scene's own program took over."""
        past = self.read()
        self._write(replace(past, gains=(*past.gains, gain)[-KEPT:]))

    def add_rate(self, rate: float) -> None:
        """A scene was rendered at so many samples a second."""
        past = self.read()
        self._write(replace(past, rates=(*past.rates, rate)[-KEPT:]))

    def _write(self, past: Past) -> None:
        with contextlib.suppress(OSError):
            cache.put(self._path, json.dumps(asdict(past)).encode())


def _parse(data: dict[str, Any]) -> Past:
    past = Past(
        tuple((int(lines), float(seconds)) for lines, seconds in data["builds"]),
        tuple(float(gain) for gain in data["gains"]),
        tuple(float(rate) for rate in data["rates"]),
        tuple((str(program), float(seconds)) for program, seconds in data["spent"]),
    )
    seconds = [seconds for _, seconds in (*past.builds, *past.spent)]
    if not all(map(_positive, [*seconds, *past.gains, *past.rates])):
        raise ValueError("numbers that cannot be")
    return past


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0
