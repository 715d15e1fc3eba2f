"""The real backend of a device process: penumbra_kernels on an OpenCL device. Only device processes import
it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.allotment import Allotment
from penumbra_kernels.assets import AssetError, Assets, NoAssets
from penumbra_kernels.compile.scene import CompiledScene, compile_scene
from penumbra_kernels.device import BuildError, Device, DeviceError, DeviceInfo, devices
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.program import assemble, source_hash
from penumbra_kernels.tracer import SamplePlan, Tracer
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


class LoadedOnDevice:
    """A scene with its tracer."""

    def __init__(
        self, device: Device, compiled: CompiledScene, spec: RenderSpec, build_seconds: float
    ) -> None:
        plan = SamplePlan(spec.replicates, spec.strata)
        tracer = Tracer(device, compiled, plan, program=spec.program)
        started = time.perf_counter()
        tracer.trace(_WARM_UP, 0, 1)
        self.compile_seconds = tracer.compile_seconds + time.perf_counter() - started
        self.compile_warm = not tracer.compiled_cold
        self.build_seconds = build_seconds + tracer.upload_seconds
        generic = spec.program == "generic"
        self.effects = tuple((v.name, v.present or generic, v.reason) for v in compiled.features.verdicts)
        self.program_hash = source_hash(assemble("trace.cl", {**tracer.flags, **device.flags}))
        self._tracer = tracer

    def trace(self, tile: Tile, first: int, count: int, allotment: Allotment | None) -> SumNode:
        try:
            return self._tracer.trace(tile, first, count, allotment)
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error


class OpenCLBackend:
    """One opened device."""

    def __init__(self) -> None:
        self._device: Device | None = None
        self._trees = Trees()

    def list(self) -> list[DeviceDescription]:
        return [describe(info) for info in devices()]

    def open(self, device_id: str) -> DeviceDescription:
        try:
            self._device = Device(device_id)
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error
        return describe(self._device.info)

    def load(self, spec: RenderSpec) -> LoadedOnDevice:
        device = self._device
        assert device is not None
        started = time.perf_counter()
        scene = Scene.model_validate_json(Path(spec.scene_path).read_bytes())
        try:
            compiled = compile_scene(scene, assets_of(spec), spec.time, self._trees)
        except (AssetError, ValueError) as error:  # too many of something, a matrix without an inverse
            raise SceneError(str(error)) from error
        seconds = time.perf_counter() - started
        try:
            return LoadedOnDevice(device, compiled, spec, seconds)
        except BuildError as error:
            raise BuildRefusedError(str(error)) from error
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error


def assets_of(spec: RenderSpec) -> Assets:
    """The assets that a spec's scene may name."""
    if spec.assets_folder is None:
        return NoAssets()
    beside = None if spec.scene_folder is None else Path(spec.scene_folder)
    return FolderAssets(Path(spec.assets_folder), beside, limits=spec.decode)
