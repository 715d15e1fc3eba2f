"""A process that builds programs into the cache, and the handle that others hold on it.

    python -m penumbra_kernels.compiler --device pocl:0    reads one JSON object of flags a line, answers each with a line

Compiling stalls all queues of the process that does it, and a driver may abort that process; so neither a device's own process
nor a command compiles while it has other things to do. What is built is found in the cache (cache.py) by whoever wants it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import select
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

from penumbra_kernels import pocl_cache
from penumbra_kernels.program import assemble

if TYPE_CHECKING:
    from penumbra_kernels.device import Device
    from penumbra_kernels.tracer import Flags

COMMAND: Final = (sys.executable, "-m", "penumbra_kernels.compiler")


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
    return device.has_binary(assemble("trace.cl", {**flags, **device.flags}))


class Compiler:
    """A compiler process for one device. It starts with the first order, and ends with this object's process or `close`."""

    def __init__(self, device_id: str) -> None:
        self._device_id = device_id
        self._process: subprocess.Popen[bytes] | None = None
        self._orders = 0

    def order(self, flags: Flags) -> None:
        """Have a program built; orders are answered one after the other."""
        if self._process is None:
            self._process = subprocess.Popen(
                [*COMMAND, "--device", self._device_id],
                bufsize=0,  # so that an answer that was not read yet shows in `select`
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=pocl_cache.own_environment(),
            )
        assert self._process.stdin is not None
        self._orders += 1
        with contextlib.suppress(BrokenPipeError):  # `answer` tells
            self._process.stdin.write(json.dumps(dict(flags)).encode() + b"\n")

    def answer(self, timeout: float | None = None) -> Built | None:
        """What became of the oldest order; None where that is not known within `timeout` seconds, or nothing was ordered.

        Where the process died, nothing was built: whoever needs the program has to build it himself.
        """
        if not self._orders:
            return None
        if self._process is None:
            self._orders -= 1
            return Built(0.0, built=False, died=True)
        assert self._process.stdout is not None
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
        if self._process is not None:
            self._process.kill()
            self._end()

    def _end(self) -> None:
        assert self._process is not None
        self._process.communicate()
        self._process = None


def main() -> None:
    """The process's whole life: until its standard input ends."""
    from penumbra_kernels.device import BuildError, Device, DeviceError
    from penumbra_kernels.tracer import build_program

    parser = argparse.ArgumentParser(
        prog="compiler", description="Builds Penumbra's programs into the cache."
    )
    parser.add_argument("--device", help="the device's id, such as pocl:0")
    try:
        device = Device(parser.parse_args().device)
    except DeviceError as error:
        sys.exit(str(error))
    for line in sys.stdin:
        started, before = time.perf_counter(), device.builds
        problem = None
        try:
            build_program(device, json.loads(line))
        except BuildError as error:
            problem = str(error)
        built = Built(time.perf_counter() - started, device.builds > before, problem)
        print(json.dumps(asdict(built)), flush=True)


if __name__ == "__main__":
    main()
