"""Programs of one device: which are there, which are being built, and which one a scene begins with.

Only device processes import it. The rule is penumbra_kernels/choice.py's, what it predicts from penumbra_kernels/history.py's.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from penumbra_kernels.choice import (
    LANES_GAIN,
    PLAIN_SHARE,
    Choice,
    Program,
    choose,
    is_short,
    seconds_to_come,
)
from penumbra_kernels.compiler import Built, Compiler, Fork
from penumbra_kernels.device import Device
from penumbra_kernels.features import Features
from penumbra_kernels.history import History
from penumbra_kernels.program import active_lines, assemble, source_hash
from penumbra_kernels.tracer import Flags
from penumbra_scene.scene import Scene

LEAST_PREDICTED: Final = 0.05
"""Seconds that a program under way takes at least, however late it is."""


@dataclass
class Order:
    """A program that another process builds."""

    lines: int
    seconds: float
    """Predicted."""
    plain: bool = False
    """For one path at a time: what it takes says nothing of others."""
    built: Built | None = None
    """Null until it has answered."""

    @property
    def tells(self) -> bool:
        """Whether it was built, so that what it took says what others will take."""
        return self.built is not None and self.built.built and self.built.problem is None and not self.plain


@dataclass(frozen=True)
class Beginning:
    """How a scene begins."""

    first: Program
    plain: bool
    """It is the scene's own for one path at a time."""
    order: Order | None
    """Of the program that renders first; null: it is in the cache."""
    own: Order | None
    """Of the scene's own program, where another one renders first and that one is worth building."""


class Programs:
    """Of one opened device."""

    def __init__(self, device: Device, forked: Fork | None = None) -> None:
        """forked: a compiler's process."""
        self._device = device
        self._compiler = Compiler(device.info.id, forked)
        self._history = History(device.info)
        self._orders: deque[Order] = deque()
        """Not answered yet, the oldest first."""

    def text(self, flags: Flags) -> str:
        """A program's whole text on this device."""
        return _text(tuple(sorted(self._device.macros(flags).items())))

    def cached(self, text: str) -> bool:
        """Whether a program is in the cache."""
        return self._device.has_binary(text)

    def order(self, flags: Flags) -> Order:
        """Have a program built."""
        self._compiler.order(flags)  # first: counting lines takes a while
        order = Order(_lines(self.text(flags)), self._build_seconds(flags), not flags["PENUMBRA_TOGETHER"])
        self._orders.append(order)
        return order

    def poll(self) -> None:
        """Take in what the compiler's process has answered."""
        while self._orders and (built := self._compiler.answer(0.0)) is not None:
            order = self._orders.popleft()
            order.built = built
            if order.tells:
                self._history.add_build(order.lines, built.seconds)

    def begin(self, scene: Scene, features: Features, wanted: str) -> Beginning:
        """Which program a scene begins with, and what is ordered now. wanted: 'auto', or one's name."""
        choice = self.choose(scene, features) if wanted == "auto" else None
        first: Program = "generic" if "generic" in (wanted, choice and choice.first) else "specialised"
        plain = wanted == "auto" and first == "specialised" and self._begins_plain(scene, features)
        own_flags = features.plain_flags() if plain else features.flags()
        flags = features.generic_flags() if first == "generic" else own_flags
        order = None if self.cached(self.text(flags)) else self.order(flags)
        build_own = choice is not None and choice.build_own
        if plain and order is None:
            build_own = self.wants_lanes(scene, features)
        own = self.order(features.flags()) if build_own else None
        return Beginning(first, plain, order, own)

    def _begins_plain(self, scene: Scene, features: Features) -> bool:
        """Whether a job on a CPU is done by its own program for one path at a time before that for sixteen is built."""
        if self._device.info.kind != "cpu" or features.sampler == "random":
            return False
        waits = self._wait(features.plain_flags()), self._wait(features.flags())
        return is_short(planned_paths(scene), *waits, self._device.info.compute_units)

    def wants_lanes(
        self, scene: Scene, features: Features, samples: float = 0.0, seconds: float = 0.0
    ) -> bool:
        """Whether the program for sixteen paths is worth building for a scene that was thought to be done before: one path at
        a time took so long for so many samples, or has rendered so much for other jobs that asked for the same."""
        self.poll()
        left = max((planned_paths(scene) or 0.0) - samples, 0.0)
        own = features.flags()
        spent = self._history.read().spent_for(source_hash(self.text(own)))
        to_come = max(left * seconds / samples if samples else 0.0, spent)
        choice = choose(self._wait(own), 0.0, to_come, LANES_GAIN, self._share)
        return choice.build_own or choice.first == "specialised"  # another job had it built

    def choose(self, scene: Scene, features: Features, done: float = 0.0) -> Choice:
        """What a scene begins with, or, `done` seconds after it began with the generic program, goes on with."""
        own, generic = self.text(features.flags()), self.text(features.generic_flags())
        if own == generic or self.cached(own):
            return Choice("specialised", build_own=False)
        if not self.cached(generic):  # it has more lines, so that the scene's own is there before it
            return Choice("specialised", build_own=False)
        self.poll()
        past = self._history.read()
        to_come = seconds_to_come(planned_seconds(scene, past.rate), done, past.spent_for(source_hash(own)))
        return choose(self._wait(features.flags()), 0.0, to_come, past.gain, self._share)

    @property
    def _share(self) -> float:
        """Of the device's speed that building takes away meanwhile."""
        return 1.0 / self._device.info.compute_units if self._device.info.kind == "cpu" else 0.0

    def spend(self, features: Features, seconds: float) -> None:
        """Another program has rendered for a scene whose own program is not built."""
        self._history.add_spent(source_hash(self.text(features.flags())), seconds)

    def note_gain(self, gain: float) -> None:
        """A scene's own program was so much faster."""
        self._history.add_gain(gain)

    def note_rate(self, samples_per_second: float) -> None:
        """The generic program was so fast."""
        self._history.add_rate(samples_per_second)

    def _wait(self, flags: Flags) -> float:
        """Predicted until a program is ready; orders before it are built first."""
        if self.cached(self.text(flags)):
            return 0.0
        before = sum(max(order.seconds, LEAST_PREDICTED) for order in self._orders)
        return before + self._build_seconds(flags)

    def _build_seconds(self, flags: Flags) -> float:
        """Predicted; of a program for one path at a time by that for sixteen."""
        lines = _lines(self.text({**flags, "PENUMBRA_TOGETHER": 1}))
        seconds = self._history.read().build_seconds(lines, self._device.info.kind)
        return seconds if flags["PENUMBRA_TOGETHER"] else PLAIN_SHARE * seconds


@lru_cache(32)
def _text(flags: tuple[tuple[str, int], ...]) -> str:
    return assemble("trace.cl", dict(flags))


@lru_cache(32)
def _lines(text: str) -> int:
    return active_lines(text)


def planned_seconds(scene: Scene, rate: float | None) -> float | None:
    """Seconds of rendering that a scene's stop rule allows at so many samples a second; None where it does not tell."""
    stop, paths = scene.stop, planned_paths(scene)
    limits = [stop.seconds] if stop.seconds is not None else []
    if paths is not None and rate is not None:
        limits.append(paths / rate)
    return min(limits, default=None)


def planned_paths(scene: Scene) -> float | None:
    """Samples of all pixels that a scene's stop rule allows; None where it does not tell."""
    window = scene.film.window
    return None if scene.stop.samples is None else scene.stop.samples * window.width * window.height
