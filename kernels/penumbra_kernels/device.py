"""OpenCL devices: finding them, building programs on them, their queues and buffers. The only home of pyopencl.

A device is named `platform:index`, for instance `pocl:0`. Importing this module is cheap; pyopencl is loaded when the
first device is asked for.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from platform import machine
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakValueDictionary

import numpy as np

from penumbra_kernels import cache, pocl_cache, pocl_front_end
from penumbra_kernels.aligned import aligned
from penumbra_kernels.pocl_target import UNKNOWN, name_target
from penumbra_kernels.program import BUILD_OPTIONS, assemble, settle

if TYPE_CHECKING:
    import pyopencl as cl

KIND_CPU: Final = "cpu"
KIND_GPU: Final = "gpu"

SHARED_BYTES: Final = 4 * 1024 * 1024
"""Buffers of that size lie in numpy's memory on CPUs, where an OpenCL driver would copy them into its own: numpy asks the
system for huge pages from that size on, without which a large tree's nodes are hardly ever in the TLB."""
NVIDIA_REGISTERS: Final = 64
"""A thread. Left alone the compiler takes 200 to 250 for a path tracer, so that few threads are there to hide each other's
waiting. Measured on an H200, M paths/s of the Cornell box / a mesh of 100k triangles: 78 / 106 as it likes, 91 / 116 with
128 registers, 101 / 108 with 96, 115 / 138 with 64 (spills included)."""


class DeviceError(RuntimeError):
    """A device is missing, or would not do what was asked; the message says which and why."""


class BuildError(DeviceError):
    """The device's compiler refused a program; the message carries its log with our file names and lines."""


@dataclass(frozen=True)
class DeviceInfo:
    """What a device says of itself."""

    id: str
    name: str
    platform: str
    platform_version: str
    driver: str
    kind: str
    compute_units: int
    memory_bytes: int
    max_allocation_bytes: int
    target: str = ""
    """The instruction set that a CPU's programs are compiled for, in LLVM's names; empty where the driver does not say."""

    @property
    def bit_class(self) -> str:
        """Devices of one bit class give the same bits for the same program (with its hash)."""
        return "|".join(filter(None, (self.platform_version, self.driver, self.name, self.target)))


def _platform_key(name: str) -> str:
    if "Portable Computing Language" in name:
        return "pocl"
    return name.lower().split()[0].replace("(r)", "").replace("(tm)", "")


def _describe(device: cl.Device, platform: cl.Platform, number: int) -> DeviceInfo:
    import pyopencl as cl

    kind = KIND_GPU if device.type & cl.device_type.GPU else KIND_CPU
    return DeviceInfo(
        id=f"{_platform_key(platform.name)}:{number}",
        name=device.name.strip(),
        platform=platform.name.strip(),
        platform_version=platform.version.strip(),
        driver=device.driver_version.strip(),
        kind=kind,
        compute_units=device.max_compute_units,
        memory_bytes=device.global_mem_size,
        max_allocation_bytes=device.max_mem_alloc_size,
        target=_target(device),
    )


def _target(device: cl.Device) -> str:
    """PoCL's version ends in the triple and the processor it compiles for: `HSTR: pthread-<triple>-<processor>`."""
    _, told, host = device.version.partition("HSTR: ")
    if not told:
        return ""
    name = host.rpartition("linux-gnu-")[2].strip()
    return (name_target(device.int_ptr) or name) if name == UNKNOWN.decode() else name


def _enumerate() -> list[tuple[DeviceInfo, Any]]:
    import pyopencl as cl

    pocl_cache.take_scratch(cache.folder() / "scratch")
    found: list[tuple[DeviceInfo, Any]] = []
    try:
        platforms = cl.get_platforms()
    except cl.LogicError:
        return found
    for platform in platforms:
        try:
            devices = platform.get_devices()
        except cl.Error:
            continue
        for number, device in enumerate(devices):
            found.append((_describe(device, platform, number), device))
    return found


def import_bindings() -> None:
    """Load pyopencl, and no driver: those come when devices are looked for."""
    import pyopencl  # noqa: F401


def devices() -> list[DeviceInfo]:
    """Every OpenCL device of this machine, in the platforms' order; empty where there is none."""
    return [info for info, _ in _enumerate()]


class Device:
    """One opened OpenCL device: a context, an in-order queue, and the programs built on it."""

    def __init__(self, device_id: str | None = None, tree: str | None = None) -> None:
        """tree: 'wide' (eight lanes a ray: CPUs) or 'compact' (a thread a ray: GPUs); None: by the device's kind."""
        import pyopencl as cl

        found = _enumerate()
        matching = [pair for pair in found if device_id is None or pair[0].id == device_id]
        if not matching:
            have = ", ".join(info.id for info, _ in found) or "none"
            raise DeviceError(f"no OpenCL device {device_id or ''!r}; this machine has: {have}")
        self.info, handle = matching[0]
        self.tree = tree or ("compact" if self.info.kind == KIND_GPU else "wide")
        self.options = _options(handle)
        self.context = cl.Context([handle])
        self.queue = cl.CommandQueue(self.context, handle)
        self.builds = 0
        """Programs that this object had the compiler build; a warm start leaves it at 0."""
        self._alive: WeakValueDictionary[str, cl.Program] = WeakValueDictionary()
        """Programs that somebody holds, by their keys: the next scene with the same ones need not load them."""

    @property
    def flags(self) -> dict[str, int]:
        """Macros that the device's kind decides: the seam between CPU and GPU variants."""
        builtins = self.info.kind == KIND_CPU and not _portable()
        return {
            "PENUMBRA_DEVICE_GPU": int(self.info.kind == KIND_GPU),
            "PENUMBRA_COMPACT_TREE": int(self.tree == "compact"),
            "PENUMBRA_BUILTINS": int(builtins),
            # An OpenCL CPU is this machine's; its name tells a model, not always the instruction set.
            "PENUMBRA_X86": int(builtins and machine().lower() in ("x86_64", "amd64")),
        }

    def macros(self, flags: Mapping[str, int]) -> dict[str, int]:
        """Of trace.cl with these flags, which may hold some of the device's kind too, to build another kind's variant."""
        merged = settle({**self.flags, **flags})
        bare = merged["PENUMBRA_BUILTINS"] and pocl_front_end.is_known(self.info.platform_version)
        return {**merged, "PENUMBRA_BARE": int(bare)}

    def build(
        self,
        entry: str,
        flags: Mapping[str, int],
        text: str | None = None,
        *,
        first_launch: Callable[[cl.Program], None] | None = None,
    ) -> cl.Program:
        """Assemble and build a program, from the cache where it is there. Raises BuildError with the log.

        flags: as for `macros`.
        first_launch: launches the kernels without doing anything. Drivers that compile at a kernel's first launch do it
        then, before the binary is taken, so that it holds the final code.
        """
        import pyopencl as cl

        macros = self.macros(flags) if text is None else {**self.flags, **flags}
        source = assemble(entry, macros, text)
        key = self.cache_key(source)
        known = self._held(key) or self._from_cache(key)
        if known is not None:
            self._alive[key] = known
            return known
        try:
            program: cl.Program = cl.Program(self.context, source)
            program.build([*self.options, *pocl_front_end.options_of(bool(macros.get("PENUMBRA_BARE")))])
        except cl.Error as error:
            raise BuildError(
                f"{entry} does not build on {self.info.id} ({self.info.name}):\n{error}"
            ) from error
        self.builds += 1
        if first_launch is not None:
            first_launch(program)
            pocl_cache.spare_any_size()
        binaries: Any = program.get_info(cl.program_info.BINARIES)
        cache.store(key, binaries[0])
        self._alive[key] = program
        return program

    def load_compiler(self) -> None:
        """Have the driver load what building any program needs: PoCL its built-in functions, 7 MB that it takes .25 s to
        read. Raises nothing: whoever builds is told."""
        import pyopencl as cl

        bare = pocl_front_end.options_of(pocl_front_end.is_known(self.info.platform_version))
        with suppress(cl.Error):
            cl.Program(self.context, "__kernel void nothing(void) {}").build([*self.options, *bare])

    def cache_key(self, source: str) -> str:
        """Names the program of a flattened source on this device."""
        return cache.key(source, self.options, self.info)

    def has_binary(self, source: str) -> bool:
        """Whether the program of a flattened source is in the cache."""
        return cache.has(self.cache_key(source))

    def _held(self, key: str) -> cl.Program | None:
        """A program that a scene has loaded."""
        program = self._alive.get(key)
        if program is not None:
            cache.note_use(key)
        return program

    def _from_cache(self, key: str) -> cl.Program | None:
        """The program whose binary is stored; None where there is none that the driver takes."""
        import pyopencl as cl

        binary = cache.load(key)
        if binary is None:
            return None
        try:
            program: cl.Program = cl.Program(self.context, self.context.devices, [binary])
            program.build(list(self.options))
        except cl.Error:
            cache.discard(key)
            return None
        return program

    def upload(self, array: np.ndarray[Any, Any]) -> cl.Buffer:
        """A read-only buffer with a copy of the array's bytes; at least 16, so that empty arrays are valid."""
        import pyopencl as cl

        data = np.ascontiguousarray(array).view(np.uint8).reshape(-1)
        if data.size < 16:
            data = np.concatenate([data, np.zeros(16 - data.size, np.uint8)])
        shared = self.info.kind == KIND_CPU and data.size >= SHARED_BYTES
        origin = cl.mem_flags.USE_HOST_PTR if shared else cl.mem_flags.COPY_HOST_PTR
        flags = cl.mem_flags.READ_ONLY | origin
        with self._driver(f"copying {data.size} bytes to the device"):
            return cl.Buffer(self.context, flags, hostbuf=aligned(data) if shared else data)

    def allocate(self, size: int) -> cl.Buffer:
        """A read-write buffer of `size` bytes, its content undefined."""
        import pyopencl as cl

        with self._driver(f"allocating {size} bytes"):
            return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size=max(size, 16))

    def launch(self, kernel: cl.Kernel, arguments: Sequence[Any], count: int, local: int) -> None:
        """Run `count` work-items (more than none) in groups of `local`, and wait.

        The caller keeps the argument buffers alive.
        """
        import pyopencl as cl

        with self._driver(f"running {kernel.function_name} over {count} work-items"):
            kernel.set_args(*arguments)
            cl.enqueue_nd_range_kernel(self.queue, kernel, (count,), (local,)).wait()

    def download(self, buffer: cl.Buffer, out: np.ndarray[Any, Any]) -> None:
        """Fill a contiguous array from a buffer; waits for the queue."""
        import pyopencl as cl

        with self._driver(f"copying {out.nbytes} bytes from the device"):
            cl.enqueue_copy(self.queue, out, buffer)

    def download_rows(self, buffer: cl.Buffer, out: np.ndarray[Any, Any], stride: int) -> None:
        """Fill a contiguous array, row by row, from a buffer whose rows are `stride` bytes apart; waits for the queue."""
        import pyopencl as cl

        size = out[0].nbytes
        with self._driver(f"copying {out.nbytes} bytes from the device"):
            cl.enqueue_copy(  # type: ignore[call-overload]  # its stub has another name for buffer_origin
                self.queue,
                out,
                buffer,
                buffer_origin=(0, 0),
                host_origin=(0, 0),
                region=(size, len(out)),
                buffer_pitches=(stride,),
                host_pitches=(size,),
            )

    @contextmanager
    def _driver(self, what: str) -> Iterator[None]:
        """Turn the driver's errors into DeviceError."""
        import pyopencl as cl

        try:
            yield
        except cl.Error as error:
            raise DeviceError(f"{self.info.id} ({self.info.name}) failed {what}: {error}") from error


def _options(device: cl.Device) -> tuple[str, ...]:
    """BUILD_OPTIONS and what a GPU has to be asked for: IEEE division and square roots (OpenCL 1.2, section 7.4), and on
    NVIDIA's driver fewer registers a thread, which changes no bits."""
    import pyopencl as cl

    options = [*BUILD_OPTIONS, *pocl_front_end.options(device.platform.version)]
    if device.type & cl.device_type.GPU:
        if device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
            options.append("-cl-fp32-correctly-rounded-divide-sqrt")
        if "cl_nv_compiler_options" in device.extensions.split():
            options.append(f"-cl-nv-maxrregcount={NVIDIA_REGISTERS}")
    return tuple(options)


def _portable() -> bool:
    """PENUMBRA_PORTABLE=1 picks the branch without compiler builtins, for oclgrind and strange compilers."""
    return os.environ.get("PENUMBRA_PORTABLE", "0") == "1"
