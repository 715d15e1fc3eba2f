"""A device process without OpenCL: its 'samples' are hashes of (seed, pixel, replicate, sample index).

The scene's name says how it behaves: words among slow, steady (so many samples a second), compiling (in another process),
goes-over (after GENERIC_LEASES leases by another program),
crash-load, crash-trace, hang, rejected, bad-scene, bad-build, bad-device. In the environment FAKE_DEVICES names the
devices (commas), FAKE_BROKEN those that cannot be opened, FAKE_RATE is the samples a second of a steady scene,
FAKE_BIT_CLASS the devices' bit class, and FAKE_HABIT what a device does whatever the scene: garbage (wrong sums) or
refuse (the driver has no memory).
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from penumbra_kernels.allotment import Allotment
from penumbra_kernels.nodes import SumNode, Tile, merge
from penumbra_kernels.sums import no_sums
from penumbra_scene.scene import Scene
from penumbra_service.engine.device_process import (
    BuildRefusedError,
    DeviceRefusedError,
    SceneError,
    main,
)
from penumbra_service.engine.protocol import DeviceDescription, RenderSpec

SLOW_SECONDS = 0.05
COMPILE_SECONDS = 1.0
GENERIC_LEASES = 3
HABIT = os.environ.get("FAKE_HABIT", "")
RATE = float(os.environ.get("FAKE_RATE", "2e6"))


def _uniform(seed: int, tile: Tile, replicates: int, index: int) -> NDArray[np.float32]:
    y, x = np.mgrid[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width].astype(np.uint64)
    r = np.arange(replicates, dtype=np.uint64)[:, None, None]
    key = (x << np.uint64(40)) ^ (y << np.uint64(20)) ^ (r << np.uint64(12)) ^ np.uint64(index << 44)
    key = key ^ np.uint64(seed * 0x5851F42D4C957F2D % 2**64)
    for _ in range(3):
        key = (key ^ (key >> np.uint64(31))) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return ((key >> np.uint64(40)).astype(np.float64) * 2.0**-24).astype(np.float32)


class FakeScene:
    build_seconds = 0.01
    compile_seconds = 0.02
    compile_warm = False
    background_seconds = 0.0
    effects = (("lens", False, "nothing uses it", None), ("gloss", True, "a test says so", "/materials/a"))
    program = "specialised"
    program_hash = "0" * 64

    def __init__(self, scene: Scene, spec: RenderSpec) -> None:
        self.scene = scene
        self.spec = spec
        self.lease = 0
        if "goes-over" in scene.name:
            self.program, self.program_hash = "generic", "1" * 64

    def go_over(self) -> None:
        self.lease += 1
        if self.lease == GENERIC_LEASES and self.program == "generic":
            self.program, self.program_hash = "specialised", "0" * 64
            self.background_seconds = 0.5

    def trace(self, tile: Tile, first: int, count: int, allotment: Allotment | None) -> SumNode:
        if "slow" in self.scene.name:
            time.sleep(SLOW_SECONDS)
        if "steady" in self.scene.name:
            time.sleep(count * tile.width * tile.height * self.spec.replicates / RATE)
        if "crash-trace" in self.scene.name:
            os.abort()
        if "hang" in self.scene.name:
            time.sleep(1000)
        if "bad-device" in self.scene.name or HABIT == "refuse":
            raise DeviceRefusedError("out of resources")
        node = self._node(tile, first, count)
        if HABIT == "garbage":
            node.sums["rgba"][..., 0, 0, 0] += 1
        return node

    def _node(self, tile: Tile, first: int, count: int) -> SumNode:
        if count > 1:
            half = count // 2
            return merge(self._node(tile, first, half), self._node(tile, first + half, half))
        sums = no_sums((self.spec.replicates, tile.height, tile.width))
        value = _uniform(self.scene.sampler.seed, tile, self.spec.replicates, first)
        for channel, weight in enumerate((1.0, 0.5, 2.0, 0.0)):
            sums["rgba"][..., channel] = np.float32(weight) * value
        sums["rgba"][..., 3] = 1
        sums["taken"] = sums["lit"] = 1
        if "rejected" in self.scene.name:
            sums["rgba"] = sums["taken"] = sums["lit"] = 0
            sums["rejected"] = 1
        return SumNode(tile, first, 1, sums)


class FakeBackend:
    def list(self) -> list[DeviceDescription]:
        names = os.environ.get("FAKE_DEVICES", "fake:0").split(",")
        return [_describe(name) for name in names if name]

    def open(self, device_id: str) -> DeviceDescription:
        if device_id in os.environ.get("FAKE_BROKEN", "").split(","):
            raise DeviceRefusedError("this device is broken")
        return _describe(device_id)

    def __init__(self) -> None:
        self._ready: dict[str, float] = {}

    def compiled(self, spec: RenderSpec) -> bool:
        return time.monotonic() >= self._ready.get(spec.key, 0.0)

    def load(self, spec: RenderSpec) -> FakeScene | None:
        scene = Scene.model_validate_json(Path(spec.scene_path).read_bytes())
        if "crash-load" in scene.name:
            print("the driver says goodbye", flush=True)
            os.abort()
        if "bad-scene" in scene.name:
            raise SceneError("image textures/wood: is not here; upload it first")
        if "bad-build" in scene.name:
            raise BuildRefusedError("trace.cl:1: error: no")
        if "compiling" in scene.name:
            self._ready.setdefault(spec.key, time.monotonic() + COMPILE_SECONDS)
        return FakeScene(scene, spec) if self.compiled(spec) else None


def _describe(name: str) -> DeviceDescription:
    bit_class = os.environ.get("FAKE_BIT_CLASS", "fake|1.0")
    return DeviceDescription(name, f"Fake {name}", "Fake", "1.0", "1.0", "cpu", 1, 1 << 30, bit_class)


if __name__ == "__main__":
    main(FakeBackend())
