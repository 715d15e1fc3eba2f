"""A process that builds programs into the cache, and the handle that others hold on it.

    python -m penumbra_kernels.compiler --device pocl:0    reads one JSON object of flags a line, answers each with a line

Compiling stalls all queues of the process that does it, and a driver may abort that process; so neither a device's own process
nor a command compiles while it has other things to do. What is built is found in the cache (cache.py) by whoever wants it.

A device's process forks its compiler before the driver is in it (`fork`): that one has all modules already, and is ready .15 s
sooner than one that starts from nothing. Such a process is told its device by its first line.
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
from penumbra_kernels.device import KIND_CPU, BuildError, Device, DeviceError, devices, import_bindings
from penumbra_kernels.program import assemble
from penumbra_kernels.tracer import build_program

if TYPE_CHECKING:
    from penumbra_kernels.tracer import Flags

COMMAND: Final = (sys.executable, "-m", "penumbra_kernels.compiler")
STANDARD_INPUT, STANDARD_OUTPUT, STANDARD_ERROR = range(3)


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
    """The whole life of a forked process."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it reaches all of a group; our parent's end is ours
        os.dup2(orders, STANDARD_INPUT)
        os.dup2(answers, STANDARD_OUTPUT)
        os.closerange(STANDARD_ERROR + 1, os.sysconf("SC_OPEN_MAX"))
        ready = _first_cpu() if cache.is_empty() else None
        with open(STANDARD_INPUT, "rb", 0, closefd=False) as told:
            if first := told.readline():
                name = json.loads(first)["device"]
                _serve(ready if ready is not None and ready.info.id == name else Device(name), told)
    except BaseException as error:  # nothing of our parent's may go on here
        print(f"the compiler's process ends: {error}", file=sys.stderr, flush=True)
    finally:
        pocl_cache.leave_scratch()
        os._exit(0)


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
        self._write(dict(flags))

    def _start(self) -> None:
        if self._forked is not None:
            self._process, self._forked = self._forked, None
            self._write({"device": self._device_id})
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


def _serve(device: Device, orders: IO[bytes]) -> None:
    """Build what is ordered, until the orders end."""
    while line := orders.readline():
        started, before = time.perf_counter(), device.builds
        problem = None
        try:
            build_program(device, json.loads(line))
        except BuildError as error:
            problem = str(error)
        built = Built(time.perf_counter() - started, device.builds > before, problem)
        os.write(STANDARD_OUTPUT, json.dumps(asdict(built)).encode() + b"\n")


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
