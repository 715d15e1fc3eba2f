"""What each effect of a scene costs, measured on a device: its seconds, by rendering without it, and its share of the noise.

    python -m penumbra_service.engine.measure_process     measuring.Request as JSON in, EffectsMeasured as JSON out

It is a process of its own, since a driver can abort the process that it is in. A budget of seconds bounds the tracing; programs
that were never built before are compiled on top.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Final

from penumbra_kernels.assets import AssetError
from penumbra_kernels.blocks import blocks_of
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_kernels.device import Device, DeviceError
from penumbra_kernels.features import analyse
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sensitivity import DETERMINISTIC, Noise, groups_of, measure
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_kernels.without import REMOVALS
from penumbra_scene.measured import EffectCost, EffectsMeasured, NoiseShare
from penumbra_scene.parse import parse_scene
from penumbra_scene.scene import Scene

from penumbra_service.engine.opencl import assets_of
from penumbra_service.engine.protocol import RenderSpec
from penumbra_service.measuring import Request

REPLICATES: Final = 8
SAMPLES: Final = 8
"""A replicate's: at more, single blocks would take too large a part of the budget."""
NOISE_BLOCKS: Final = (64, 1024)
"""At least and at most: shares have a standard error of about a few hundredths at 64."""
TIMED_BLOCKS: Final = (4, 64)
ROUNDS: Final = 7
"""Timings of each variant, in turns; the least counts, since whatever else the machine does only adds."""


def _seconds(tracer: Tracer, blocks: Sequence[Tile]) -> float:
    started = time.perf_counter()
    for block in blocks:
        tracer.trace(block, 0, SAMPLES)
    return time.perf_counter() - started


class Measurement:
    """One scene on one device."""

    def __init__(self, request: Request, device: Device) -> None:
        self.request, self.device = request, device
        scene = parse_scene(Path(request.scene).read_bytes(), allow_files=True)
        rays = request.shadow_rays or scene.integrator.shadow_rays
        integrator = scene.integrator.model_copy(update={"shadow_rays": rays})
        # Blocks take the same samples everywhere.
        self.scene = scene.model_copy(update={"adaptive": None, "integrator": integrator})
        self.plan = SamplePlan(REPLICATES, SAMPLES)
        window = self.scene.film.window
        self.window = Tile(window.x, window.y, window.width, window.height)
        self.compiled = self._compile(self.scene)
        self.tracer = Tracer(device, self.compiled, self.plan)

    def _compile(self, scene: Scene) -> CompiledScene:
        request = self.request
        spec = RenderSpec(
            scene_path=request.scene,
            scene_hash="",
            assets_folder=request.assets_folder,
            scene_folder=request.scene_folder,
            time=request.time,
            replicates=REPLICATES,
            strata=SAMPLES,
        )
        return compile_scene(scene, assets_of(spec), request.time)

    def result(self) -> EffectsMeasured:
        """All of it."""
        started = time.perf_counter()
        few = blocks_of(self.window, NOISE_BLOCKS[0])
        _seconds(self.tracer, few[:1])
        each = max(_seconds(self.tracer, few) / len(few), 1e-6)
        removals = self._removals()
        half = 0.5 * self.request.budget / each
        noisy = self._blocks(half / (2 + len(groups_of(self.compiled.features))), NOISE_BLOCKS)
        timed = self._blocks(half / (2 * ROUNDS * max(len(removals), 1)), TIMED_BLOCKS)
        noise = self._noise(noisy)
        return EffectsMeasured(
            device=self.device.info.id,
            blocks=len(noisy),
            samples=REPLICATES * SAMPLES,
            noise=() if noise is None else tuple(NoiseShare(**asdict(row)) for row in noise.rows),
            noise_peak=None if noise is None else noise.peak,
            costs=self._costs(removals, timed),
            seconds=time.perf_counter() - started,
        )

    def _blocks(self, affordable: float, bounds: tuple[int, int]) -> list[Tile]:
        least, most = bounds
        return blocks_of(self.window, int(min(max(affordable, least), most)))

    def _noise(self, blocks: Sequence[Tile]) -> Noise | None:
        if self.scene.sampler.type in DETERMINISTIC:
            return None
        noise = measure(Tracer(self.device, self.compiled, self.plan, measuring=True), blocks, SAMPLES)
        return noise if noise.peak > 0.0 else None

    def _removals(self) -> dict[str, Scene]:
        """The scene without each effect that can be taken away whole."""
        have = set(self.compiled.features.present)
        found = {}
        for name, (effects, remove) in REMOVALS.items():
            if not have.intersection(effects):
                continue
            scene = remove(self.scene)
            if not set(analyse(scene, self.request.time).present).intersection(effects):
                found[name] = scene
        return found

    def _costs(self, removals: dict[str, Scene], blocks: Sequence[Tile]) -> tuple[EffectCost, ...]:
        paths = sum(block.width * block.height for block in blocks) * REPLICATES * SAMPLES
        costs = []
        for name, scene in removals.items():
            other = Tracer(self.device, self._compile(scene), self.plan)
            pairs = [(_seconds(self.tracer, blocks), _seconds(other, blocks)) for _ in range(ROUNDS)]
            whole, without = (min(values) / paths for values in zip(*pairs, strict=True))
            costs.append(
                EffectCost(effect=name, seconds=whole, seconds_without=without, share=1 - without / whole)
            )
        return tuple(costs)


def main() -> None:
    """The process's whole life."""
    given = json.loads(sys.stdin.read())
    request = Request(**{field.name: given[field.name] for field in fields(Request)})
    try:
        result = Measurement(request, Device(request.device)).result()
    except (AssetError, DeviceError, ValueError) as error:
        sys.exit(str(error))
    print(result.model_dump_json())


if __name__ == "__main__":
    main()
