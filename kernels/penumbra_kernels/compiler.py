"""A process that builds programs into the cache, and the handle that others hold on it.

    python -m penumbra_kernels.compiler --device pocl:0    reads an order a line, answers each with a line

Compiling stalls all queues of the process that does it, and a driver may abort that process; so neither a device's own process
nor a command compiles while it has other things to do. What is built is found in the cache (cache.py) by whoever wants it.

A device's process forks its compiler before the driver is in it (`fork`): that one has all modules already, and is ready .15 s
sooner than one that starts from nothing. It builds nothing itself, but forks what does, so that it stays small (_live).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from typing import IO, TYPE_CHECKING, Any, Final, Protocol

from penumbra_kernels import cache, pocl_cache
from penumbra_kernels.child import die_with
from penumbra_kernels.device import KIND_CPU, BuildError, Device, DeviceError, devices, import_bindings
from penumbra_kernels.program import assemble
from penumbra_kernels.tracer import build_program

if TYPE_CHECKING:
    from penumbra_kernels.tracer import Flags

COMMAND: Final = (sys.executable, "-m", "penumbra_kernels.compiler")
STANDARD_INPUT, STANDARD_OUTPUT, STANDARD_ERROR = range(3)
IDLE_SECONDS: Final = 30.0
"""After its last order, until what builds for a forked process ends."""
_ENDED, _IDLE = 0, 3
"""Exit statuses of what builds: no order will come; none has come for long."""


@dataclass(frozen=True)
class Built:
    """What became of a program."""

    seconds: float
    built: bool
    """False: it was in the cache."""
    problem: str | None = None
    """Why it cannot be built."""
    died: bool = False
    """The process ended before it had an answer: nothing was built."""


def is_cached(device: Device, flags: Flags) -> bool:
    """Whether trace.cl with these flags is in the cache for this device."""
    return device.has_binary(assemble("trace.cl", device.macros(flags)))


class Process(Protocol):
    """A child, as subprocess.Popen has it; its pipes are without buffers, so that what was not read yet shows in `select`."""

    stdin: Any
    stdout: Any

    def kill(self) -> None:
        """At once, whatever it does."""

    def wait(self) -> int:
        """Until it is gone."""


@dataclass
class Fork:
    """A compiler's process that this one has forked."""

    pid: int
    stdin: IO[bytes]
    stdout: IO[bytes]

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> int:
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


def fork() -> Fork | None:
    """A compiler's process with this one's modules; None where this one has threads, which a child would be without. Before
    any device is looked for: no driver lives on in a child.

    With an empty cache something will have to be built: then it loads at once what building takes on this machine's CPU.
    """
    import_bindings()
    assemble("trace.cl", {})  # flattened once for both
    if threading.active_count() > 1:
        return None
    (orders, stdin), (stdout, answers) = os.pipe(), os.pipe()
    pid = os.fork()
    if pid == 0:
        _live(orders, answers)
    os.close(orders)
    os.close(answers)
    return Fork(pid, os.fdopen(stdin, "wb", 0), os.fdopen(stdout, "rb", 0))


def _live(orders: int, answers: int) -> None:
    """The whole life of a forked process. What has a driver and its compiler in it is large, so that others build: a process
    forked for orders that come close together, which ends once none has come for IDLE_SECONDS. What waits is small."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it reaches all of a group; our parent's end is ours
        os.dup2(orders, STANDARD_INPUT)
        os.dup2(answers, STANDARD_OUTPUT)
        os.closerange(STANDARD_ERROR + 1, os.sysconf("SC_OPEN_MAX"))
        soon = cache.is_empty()
        while (soon or _comes()) and _build_apart(soon) == _IDLE:
            soon = False
    except BaseException as error:  # nothing of our parent's may go on here
        print(f"the compiler's process ends: {error}", file=sys.stderr, flush=True)
    finally:
        os._exit(0)


def _comes() -> bool:
    """Waits for an order, which is left where it is; False where none will come."""
    waiting = select.poll()
    waiting.register(STANDARD_INPUT, select.POLLIN)
    return any(events & select.POLLIN for _, events in waiting.poll())


def _build_apart(soon: bool) -> int:
    """Have a process build what is ordered; its exit status. soon: it loads the compiler of this machine's CPU at once."""
    parent = os.getpid()
    pid = os.fork()
    if pid:
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    status = _ENDED
    try:
        die_with(parent)
        ready = _first_cpu() if soon else None
        with open(STANDARD_INPUT, "rb", 0, closefd=False) as told:
            status = _serve(ready, told, IDLE_SECONDS)
    except BaseException as error:
        print(f"the compiler's process ends: {error}", file=sys.stderr, flush=True)
    finally:
        pocl_cache.leave_scratch()
        os._exit(status)


def _first_cpu() -> Device | None:
    """This machine's first CPU, its compiler loaded."""
    name = next((info.id for info in devices() if info.kind == KIND_CPU), None)
    device = None if name is None else Device(name)
    if device is not None:
        device.load_compiler()
    return device


class Compiler:
    """A compiler process for one device. It starts with the first order, or is one that was forked before, and ends with this
    object's process or `close`."""

    def __init__(self, device_id: str, forked: Fork | None = None) -> None:
        self._device_id = device_id
        self._forked = forked
        """Not told of its device yet."""
        self._process: Process | None = None
        self._orders = 0

    def order(self, flags: Flags) -> None:
        """Have a program built; orders are answered one after the other."""
        if self._process is None:
            self._start()
        self._orders += 1
        self._write({"device": self._device_id, "flags": dict(flags)})

    def _start(self) -> None:
        if self._forked is not None:
            self._process, self._forked = self._forked, None
            return
        self._process = subprocess.Popen(
            [*COMMAND, "--device", self._device_id],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=pocl_cache.own_environment(),
        )

    def _write(self, line: dict[str, Any]) -> None:
        assert self._process is not None
        with contextlib.suppress(BrokenPipeError):  # `answer` tells
            self._process.stdin.write(json.dumps(line).encode() + b"\n")

    def answer(self, timeout: float | None = None) -> Built | None:
        """What became of the oldest order; None where that is not known within `timeout` seconds, or nothing was ordered.

        Where the process died, nothing was built: whoever needs the program has to build it himself.
        """
        if not self._orders:
            return None
        if self._process is None:
            self._orders -= 1
            return Built(0.0, built=False, died=True)
        if timeout is not None and not select.select([self._process.stdout], [], [], timeout)[0]:
            return None
        line = self._process.stdout.readline()
        if not line:
            self._end()
            return self.answer()
        self._orders -= 1
        return Built(**json.loads(line))

    def close(self) -> None:
        """End the process, whatever it does."""
        self._orders = 0
        self._process, self._forked = self._process or self._forked, None
        if self._process is not None:
            self._process.kill()
            self._end()

    def _end(self) -> None:
        assert self._process is not None
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()
        self._process = None


def _serve(device: Device | None, orders: IO[bytes], patience: float | None = None) -> int:
    """Build what is ordered, until the orders end, or none has come for `patience` seconds; an exit status that says which."""
    while select.select([orders], [], [], patience)[0]:
        if not (line := orders.readline()):
            return _ENDED
        order = json.loads(line)
        if device is None or device.info.id != order["device"]:
            device = Device(order["device"])
        started, before = time.perf_counter(), device.builds
        problem = None
        try:
            build_program(device, order["flags"])
        except BuildError as error:
            problem = str(error)
        built = Built(time.perf_counter() - started, device.builds > before, problem)
        os.write(STANDARD_OUTPUT, json.dumps(asdict(built)).encode() + b"\n")
    return _IDLE


def main() -> None:
    """The process's whole life: until its standard input ends."""
    parser = argparse.ArgumentParser(
        prog="compiler", description="Builds Penumbra's programs into the cache."
    )
    parser.add_argument("--device", help="the device's id, such as pocl:0")
    try:
        with open(STANDARD_INPUT, "rb", 0, closefd=False) as orders:
            _serve(Device(parser.parse_args().device), orders)
    except DeviceError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
