"""The real backend of a device process: penumbra_kernels on an OpenCL device. Only device processes import
it."""

from __future__ import annotations

import time
from pathlib import Path

from penumbra_kernels.accel.apart import TreeBuilder
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.assets import AssetError, Assets, NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.compiler import Fork
from penumbra_kernels.device import BuildError, Device, DeviceError, DeviceInfo, devices
from penumbra_kernels.features import analyse
from penumbra_scene.scene import Scene

from penumbra_service.engine.device_process import BuildRefusedError, DeviceRefusedError, SceneError
from penumbra_service.engine.loaded import LoadedOnDevice, Prepared
from penumbra_service.engine.programs import Programs
from penumbra_service.engine.protocol import DeviceDescription, RenderSpec
from penumbra_service.images.assets import FolderAssets


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


class OpenCLBackend:
    """One opened device, and a process beside it that compiles."""

    def __init__(self, compiler: Fork | None = None) -> None:
        """compiler: a process for it that was forked before any driver was loaded."""
        self._compiler = compiler
        self._device: Device | None = None
        self._programs: Programs | None = None
        self._prepared: dict[str, Prepared] = {}
        """Scenes that wait for their programs, by spec.key."""
        self._trees = Trees(build_large=TreeBuilder())

    def list(self) -> list[DeviceDescription]:
        return [describe(info) for info in devices()]

    def open(self, device_id: str) -> DeviceDescription:
        try:
            self._device = Device(device_id)
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error
        self._programs = Programs(self._device, self._compiler)
        return describe(self._device.info)

    def load(self, spec: RenderSpec) -> LoadedOnDevice | None:
        device, programs = self._device, self._programs
        assert device is not None
        assert programs is not None
        if spec.key not in self._prepared:
            self._prepared[spec.key] = self._prepare(programs, spec)
        if not self.compiled(spec):
            return None
        prepared = self._prepared.pop(spec.key)
        built = None if prepared.begin.order is None else prepared.begin.order.built
        if built is not None and built.problem is not None:
            raise BuildRefusedError(built.problem)
        try:
            return LoadedOnDevice(device, prepared, spec, programs)
        except BuildError as error:
            raise BuildRefusedError(str(error)) from error
        except DeviceError as error:
            raise DeviceRefusedError(str(error)) from error

    def compiled(self, spec: RenderSpec) -> bool:
        assert self._programs is not None
        self._programs.poll()
        prepared = self._prepared.get(spec.key)
        return prepared is None or prepared.begin.order is None or prepared.begin.order.built is not None

    def _prepare(self, programs: Programs, spec: RenderSpec) -> Prepared:
        """The scene's arrays. Its program is ordered first, so that both are made at the same time."""
        started = time.perf_counter()
        scene = Scene.model_validate_json(Path(spec.scene_path).read_bytes())
        features = analyse(scene, spec.time)
        begin = programs.begin(scene, features, spec.program)
        try:
            compiled = compile_scene(scene, assets_of(spec), spec.time, self._trees)
        except (AssetError, ValueError) as error:  # too many of something, a matrix without an inverse
            raise SceneError(str(error)) from error
        return Prepared(scene, compiled, time.perf_counter() - started, begin)


def assets_of(spec: RenderSpec) -> Assets:
    """The assets that a spec's scene may name."""
    if spec.assets_folder is None:
        return NoAssets()
    beside = None if spec.scene_folder is None else Path(spec.scene_folder)
    return FolderAssets(Path(spec.assets_folder), beside, limits=spec.decode)
