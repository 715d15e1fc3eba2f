"""A scene on a device, and the program that renders it: the generic one, or one without vector lanes, until the scene's own
is there, if that comes first.

Only device processes import it.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Final

from penumbra_kernels.allotment import Allotment
from penumbra_kernels.choice import Program
from penumbra_kernels.compile.scene import CompiledScene
from penumbra_kernels.device import BuildError, Device, DeviceError
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.program import source_hash
from penumbra_kernels.proof import compare
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

from penumbra_service.engine.device_process import DeviceRefusedError
from penumbra_service.engine.programs import Beginning, Programs
from penumbra_service.engine.protocol import RenderSpec

_WARM_UP: Final = Tile(0, 0, 1, 1)
"""Some drivers compile a kernel at its first launch: one sample of one pixel has them do it outside of the
tracing time."""
LOOK_SECONDS: Final = 0.25
"""Of rendering by the program that began, until the first look at whether the scene's own is worth building; each next look
comes after as long again as all before."""


@dataclass(frozen=True)
class Prepared:
    """A scene whose arrays are ready."""

    scene: Scene
    compiled: CompiledScene
    build_seconds: float
    begin: Beginning


class LoadedOnDevice:
    """A scene with its tracer. Raises BuildError, DeviceError."""

    def __init__(self, device: Device, prepared: Prepared, spec: RenderSpec, programs: Programs) -> None:
        self._scene = prepared.scene
        self._programs = programs
        window = prepared.scene.film.window
        self._window = Tile(window.x, window.y, window.width, window.height)
        self._features = prepared.compiled.features
        self.effects = tuple((v.name, v.present, v.reason, v.pointer) for v in self._features.verdicts)
        """The scene's, whichever program renders."""
        plan = SamplePlan(spec.replicates, spec.strata)
        started = time.perf_counter()
        begin = prepared.begin
        tracer = Tracer(
            device,
            prepared.compiled,
            plan,
            program=begin.first,
            together=not begin.plain,
            keep_arrays=False,
        )
        self._plain = begin.plain
        self._waits = spec.program == "auto" and (begin.first == "generic" or begin.plain)
        """Whether the scene's own program may take over."""
        self._own = begin.own
        self.background_seconds = 0.0
        """Of building the program that renders, while another one did."""
        self._samples, self._seconds, self._looked = 0, 0.0, 0.0
        """Rendered by the program that began while its own may still come; at the last look."""
        self._take(tracer, begin.first)
        self.compile_seconds = time.perf_counter() - started - tracer.upload_seconds
        self.compile_warm = not tracer.compiled_cold
        if begin.order is not None and begin.order.built is not None:
            self.compile_seconds += begin.order.built.seconds
            self.compile_warm = self.compile_warm and not begin.order.built.built
        self.build_seconds = prepared.build_seconds + tracer.upload_seconds

    def trace(self, tile: Tile, first: int, count: int, allotment: Allotment | None) -> SumNode:
        started = time.perf_counter()
        try:
            node = self._tracer.trace(tile, first, count, allotment)
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error
        if self._waits:
            self._samples += node.sums.total("taken") + node.sums.total("rejected")
            self._seconds += time.perf_counter() - started
        return node

    def go_over(self) -> None:
        """Take the scene's own program if it is there by now; see to it that it is built once that is worth it. Between
        two leases, so that each is of one program."""
        if not self._waits:
            return
        self._programs.poll()
        if self._own is None:
            self._look()
        elif self._own.built is not None:
            self._waits = False
            if self._own.built.problem is None and not self._own.built.died:
                self._switch(self._own.built.seconds)

    def _look(self) -> None:
        spent = self._seconds - self._looked
        if spent < max(LOOK_SECONDS, self._looked):
            return
        self._looked = self._seconds
        self._programs.spend(self._features, spent)
        if self._is_worth_building():
            self._own = self._programs.order(self._features.flags())

    def _is_worth_building(self) -> bool:
        if self._plain:
            return self._programs.wants_lanes(self._scene, self._features, self._samples, self._seconds)
        choice = self._programs.choose(self._scene, self._features, self._seconds)
        return choice.build_own or choice.first == "specialised"  # another job had it built

    def _switch(self, built_seconds: float) -> None:
        """Raises nothing: what does not work out leaves the program that began."""
        started = time.perf_counter()
        try:
            own = self._tracer.specialised()
            gain = compare(own, self._tracer, self._window)
        except (BuildError, DeviceError) as error:
            print(f"the scene's own program was left aside: {error}", file=sys.stderr, flush=True)
            return
        if gain is None:
            told = f"other sums than the {'plain' if self._plain else 'generic'} program's, in a picture that it has begun"
            print(f"the scene's own program was left aside: {told}", file=sys.stderr, flush=True)
            return
        if not self._plain:
            self._note(gain)
        self._take(own, "specialised")
        self.build_seconds, self.compile_warm = 0.0, False
        self.compile_seconds = time.perf_counter() - started
        self.background_seconds = built_seconds

    def _note(self, gain: float) -> None:
        """What the generic program has shown."""
        self._programs.note_gain(gain)
        if self._seconds > LOOK_SECONDS:
            self._programs.note_rate(self._samples / self._seconds)

    def _take(self, tracer: Tracer, program: Program) -> None:
        tracer.trace(_WARM_UP, 0, 1)
        self._tracer = tracer
        self.program = program
        self.program_hash = source_hash(self._programs.text(tracer.flags))
