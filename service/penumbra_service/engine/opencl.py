"""The real backend of a device process: penumbra_kernels on an OpenCL device. Only device processes import
it."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.allotment import Allotment
from penumbra_kernels.assets import AssetError, Assets, NoAssets
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_kernels.compiler import Built, Compiler, is_cached
from penumbra_kernels.device import BuildError, Device, DeviceError, DeviceInfo, devices
from penumbra_kernels.features import analyse
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.program import assemble, source_hash
from penumbra_kernels.tracer import Flags, SamplePlan, Tracer
from penumbra_scene.scene import Scene

from penumbra_service.engine.device_process import BuildRefusedError, DeviceRefusedError, SceneError
from penumbra_service.engine.protocol import DeviceDescription, RenderSpec
from penumbra_service.images.assets import FolderAssets

_WARM_UP: Final = Tile(0, 0, 1, 1)
"""Some drivers compile a kernel at its first launch: one sample of one pixel has them do it outside of the
tracing time."""


def describe(info: DeviceInfo) -> DeviceDescription:
    """A device as the service speaks of it."""
    return DeviceDescription(
        id=info.id,
        name=info.name,
        platform=info.platform,
        version=info.platform_version,
        driver=info.driver,
        kind=info.kind,
        compute_units=info.compute_units,
        memory_bytes=info.memory_bytes,
        bit_class=info.bit_class,
    )


@dataclass
class Order:
    """A program that another process builds."""

    built: Built | None = None
    """Null until it has answered."""


@dataclass(frozen=True)
class Prepared:
    """A scene whose arrays are ready."""

    compiled: CompiledScene
    build_seconds: float
    order: Order | None
    """Null: its program was in the cache."""


class LoadedOnDevice:
    """A scene with its tracer."""

    def __init__(self, device: Device, prepared: Prepared, spec: RenderSpec) -> None:
        compiled = prepared.compiled
        plan = SamplePlan(spec.replicates, spec.strata)
        tracer = Tracer(device, compiled, plan, program=spec.program, keep_arrays=False)
        started = time.perf_counter()
        tracer.trace(_WARM_UP, 0, 1)
        self.compile_seconds = tracer.compile_seconds + time.perf_counter() - started
        self.compile_warm = not tracer.compiled_cold
        if prepared.order is not None and prepared.order.built is not None:
            self.compile_seconds += prepared.order.built.seconds
            self.compile_warm = self.compile_warm and not prepared.order.built.built
        self.build_seconds = prepared.build_seconds + tracer.upload_seconds
        generic = spec.program == "generic"
        self.effects = tuple(
            (v.name, v.present or (generic and v.name != "layers"), v.reason, v.pointer)
            for v in compiled.features.verdicts
        )
        self.program_hash = source_hash(assemble("trace.cl", {**tracer.flags, **device.flags}))
        self._tracer = tracer

    def trace(self, tile: Tile, first: int, count: int, allotment: Allotment | None) -> SumNode:
        try:
            return self._tracer.trace(tile, first, count, allotment)
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error


class OpenCLBackend:
    """One opened device, and a process beside it that compiles."""

    def __init__(self) -> None:
        self._device: Device | None = None
        self._compiler: Compiler | None = None
        self._orders: deque[Order] = deque()
        """Not answered yet, the oldest first."""
        self._prepared: dict[str, Prepared] = {}
        """Scenes that wait for their programs, by spec.key."""
        self._trees = Trees()

    def list(self) -> list[DeviceDescription]:
        return [describe(info) for info in devices()]

    def open(self, device_id: str) -> DeviceDescription:
        try:
            self._device = Device(device_id)
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error
        self._compiler = Compiler(device_id)
        return describe(self._device.info)

    def load(self, spec: RenderSpec) -> LoadedOnDevice | None:
        device = self._device
        assert device is not None
        if spec.key not in self._prepared:
            self._prepared[spec.key] = self._prepare(device, spec)
        if not self.compiled(spec):
            return None
        prepared = self._prepared.pop(spec.key)
        built = None if prepared.order is None else prepared.order.built
        if built is not None and built.problem is not None:
            raise BuildRefusedError(built.problem)
        try:
            return LoadedOnDevice(device, prepared, spec)
        except BuildError as error:
            raise BuildRefusedError(str(error)) from error
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error

    def compiled(self, spec: RenderSpec) -> bool:
        assert self._compiler is not None
        while self._orders and (built := self._compiler.answer(0.0)) is not None:
            self._orders.popleft().built = built
        prepared = self._prepared.get(spec.key)
        return prepared is None or prepared.order is None or prepared.order.built is not None

    def _prepare(self, device: Device, spec: RenderSpec) -> Prepared:
        """The scene's arrays. Its program is ordered first, so that both are made at the same time."""
        started = time.perf_counter()
        scene = Scene.model_validate_json(Path(spec.scene_path).read_bytes())
        features = analyse(scene, spec.time)
        flags = features.flags() if spec.program == "specialised" else features.generic_flags()
        order = None if is_cached(device, flags) else self._order(flags)
        try:
            compiled = compile_scene(scene, assets_of(spec), spec.time, self._trees)
        except (AssetError, ValueError) as error:  # too many of something, a matrix without an inverse
            raise SceneError(str(error)) from error
        return Prepared(compiled, time.perf_counter() - started, order)

    def _order(self, flags: Flags) -> Order:
        assert self._compiler is not None
        self._compiler.order(flags)
        order = Order()
        self._orders.append(order)
        return order


def assets_of(spec: RenderSpec) -> Assets:
    """The assets that a spec's scene may name."""
    if spec.assets_folder is None:
        return NoAssets()
    beside = None if spec.scene_folder is None else Path(spec.scene_folder)
    return FolderAssets(Path(spec.assets_folder), beside, limits=spec.decode)
