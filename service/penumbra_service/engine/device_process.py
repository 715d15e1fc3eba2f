"""The process that drives one OpenCL device: `python -m penumbra_service.engine.device_process --device ID
--fd N`.

It reads leases from an inherited socket, in order, and answers each with its sum nodes. It keeps the scenes
that it used last. It ends with its parent: at the socket's end, or by the kernel's death signal where it is
deep in a driver. With `--first` in place of an id it first tells which devices there are, and drives the first that is
wanted; with `--list` it prints them as JSON, and ends.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from typing import Final, Protocol

from penumbra_kernels.allotment import Allotment
from penumbra_kernels.child import die_with
from penumbra_kernels.nodes import SumNode, Tile

from penumbra_service.engine.protocol import (
    DeviceDescription,
    Devices,
    FromDevice,
    Heartbeat,
    Hello,
    Lease,
    LeaseFailure,
    LeaseResult,
    RenderSpec,
    SceneLoaded,
    Started,
    Waiting,
)
from penumbra_service.jobs.dispatch import SCENES_KEPT

HEARTBEAT_SECONDS: Final = 2.0
COMPILE_TICK_SECONDS: Final = 0.005
"""How often a process with nothing to trace asks whether a program is there."""


class SceneError(RuntimeError):
    """The scene cannot be made ready: an asset is missing or broken."""


class BuildRefusedError(RuntimeError):
    """The device's compiler refused the program."""


class DeviceRefusedError(RuntimeError):
    """The driver refused: no memory, a lost device."""


class LoadedScene(Protocol):
    """A scene on a device."""

    build_seconds: float
    compile_seconds: float
    compile_warm: bool
    background_seconds: float
    effects: tuple[tuple[str, bool, str, str | None], ...]
    program: str
    program_hash: str

    def go_over(self) -> None:
        """Another program may take over, if it is there by now."""

    def trace(self, tile: Tile, first: int, count: int, allotment: Allotment | None) -> SumNode:
        """Raises DeviceRefusedError."""


class Backend(Protocol):
    """A device and how scenes get onto it."""

    def list(self) -> list[DeviceDescription]:
        """All devices of this machine."""

    def open(self, device_id: str) -> DeviceDescription:
        """Take hold of one. Raises DeviceRefusedError."""

    def load(self, spec: RenderSpec) -> LoadedScene | None:
        """None while another process compiles the scene's program: ask again.

        Raises SceneError, BuildRefusedError, DeviceRefusedError.
        """

    def compiled(self, spec: RenderSpec) -> bool:
        """Whether `load` would have an answer now."""


class DeviceProcess:
    """Reads leases, answers them."""

    def __init__(self, backend: Backend, connection: Connection) -> None:
        self._backend = backend
        self._connection = connection
        self._sending = threading.Lock()
        self._scenes: OrderedDict[str, LoadedScene] = OrderedDict()
        self._told: set[tuple[str, str, str]] = set()
        """(job, scene, program)."""
        self._waiting: list[Lease] = []
        self._phase = "idle"

    def introduce(self, wanted: Sequence[str]) -> str | None:
        """Tell the machine's devices; which to go on with: the first of those wanted, of all where none are named."""
        devices = tuple(self._backend.list())
        opening = next((d.id for d in devices if not wanted or d.id in wanted), None)
        self._send(Devices(devices, opening))
        return opening

    def run(self, device_id: str) -> None:
        """Until the parent is gone or says so."""
        self._send(Hello(self._backend.open(device_id)))
        threading.Thread(target=self._beat, daemon=True).start()
        while True:
            try:
                lease = self._next()
            except (EOFError, OSError):
                return
            if lease is None:
                return
            self._do(lease)
            self._phase = "idle"

    def _next(self) -> Lease | None:
        """A lease that just came, or one that waited and whose program is there by now. None: the end."""
        while self._waiting:
            ready = next((lease for lease in self._waiting if self._backend.compiled(lease.spec)), None)
            if ready is not None:
                self._waiting.remove(ready)
                return ready
            if self._connection.poll(COMPILE_TICK_SECONDS):
                break
        lease = self._connection.recv()
        assert lease is None or isinstance(lease, Lease)
        return lease

    def _do(self, lease: Lease) -> None:
        self._send(Started(lease.id))
        try:
            scene = self._scene(lease)
            if scene is None:
                self._waiting.append(lease)
                self._send(Waiting(lease.id))
                return
            self._phase = f"trace {lease.id}"
            started = time.perf_counter()
            nodes = tuple(
                scene.trace(item.tile, item.first, item.count, lease.allotments.get(item.tile))
                for item in lease.items
            )
            seconds = time.perf_counter() - started
            self._send(LeaseResult(lease.id, nodes, seconds, scene.program, scene.program_hash))
        except SceneError as error:
            self._send(LeaseFailure(lease.id, "scene", str(error)))
        except BuildRefusedError as error:
            self._send(LeaseFailure(lease.id, "build", str(error)))
        except DeviceRefusedError as error:
            self._scenes.clear()
            self._send(LeaseFailure(lease.id, "device", str(error)))
        except (BrokenPipeError, ConnectionError):
            sys.exit(0)
        except Exception as error:  # the job must hear of our own mistakes too
            traceback.print_exc()
            self._send(LeaseFailure(lease.id, "internal", f"{type(error).__name__}: {error}"))

    def _scene(self, lease: Lease) -> LoadedScene | None:
        """From the scenes that are loaded, or load it; tells the job, once for each program. None while its program is
        compiled."""
        key = lease.spec.key
        scene = self._scenes.get(key)
        warm = scene is not None
        if scene is not None:
            before = scene.program_hash
            scene.go_over()
            warm = scene.program_hash == before
        if scene is None:
            self._phase = f"load {lease.job}"
            scene = self._backend.load(lease.spec)
            if scene is None:
                return None
            while len(self._scenes) >= SCENES_KEPT:
                self._scenes.popitem(last=False)
            self._scenes[key] = scene
        self._scenes.move_to_end(key)
        told = (lease.job, key, scene.program_hash)
        if not warm or told not in self._told:
            self._told.add(told)
            self._send(_loaded(lease.job, scene, warm))
        return scene

    def _send(self, message: FromDevice) -> None:
        with self._sending:
            self._connection.send(message)

    def _beat(self) -> None:
        while True:
            time.sleep(HEARTBEAT_SECONDS)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            try:
                self._send(Heartbeat(self._phase, peak))
            except OSError:
                return


def _loaded(job: str, scene: LoadedScene, warm: bool) -> SceneLoaded:
    return SceneLoaded(
        job,
        build_seconds=0.0 if warm else scene.build_seconds,
        build_warm=warm,
        compile_seconds=0.0 if warm else scene.compile_seconds,
        compile_warm=warm or scene.compile_warm,
        effects=scene.effects,
        program=scene.program,
        program_hash=scene.program_hash,
        background_seconds=0.0 if warm else scene.background_seconds,
    )


def main(backend: Backend, arguments: Sequence[str] | None = None) -> None:
    """The process's whole life. Tests pass a backend that needs no device."""
    parser = argparse.ArgumentParser(
        prog="device_process", description="Drives one OpenCL device for Penumbra."
    )
    parser.add_argument("--list", action="store_true", help="print the machine's devices as JSON and end")
    parser.add_argument("--first", action="store_true", help="tell the machine's devices, and drive one")
    parser.add_argument("--wanted", default="", help="with --first: ids to choose from, commas between them")
    parser.add_argument("--device", help="the device's id, such as pocl:0")
    parser.add_argument("--fd", type=int, help="the inherited socket")
    parser.add_argument("--parent", type=int, help="process id to die with")
    options = parser.parse_args(arguments)
    if options.list:
        print(json.dumps([asdict(device) for device in backend.list()]), flush=True)
        return
    # Ctrl-C reaches the whole process group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with(options.parent)
    process = DeviceProcess(backend, Connection(options.fd))
    try:
        wanted = [name for name in options.wanted.split(",") if name]
        device = process.introduce(wanted) if options.first else options.device
        if device is not None:
            process.run(device)
    except DeviceRefusedError as error:  # the last words are what the service shows
        sys.exit(str(error))


if __name__ == "__main__":
    from penumbra_kernels.compiler import fork

    compiler = fork()  # before more is loaded than a compiler needs

    from penumbra_service.engine import device_process, opencl

    # By its real name: exceptions of `__main__` would be others than those that the backend raises.
    device_process.main(opencl.OpenCLBackend(compiler))
    # Nothing is left to do: not to wait for the interpreter and the driver to take themselves apart.
    sys.stdout.flush()
    os._exit(0)
