"""`penumbra worker`: a process for each OpenCL device of this machine, started again whenever it ends.

Dask's workers end with code 0 when their scheduler is killed: here they come back and look for it again.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Final

from penumbra_kernels import cache

from penumbra_service.engine.dask.addresses import check_scheduler, security
from penumbra_service.engine.launch import DEVICE_COMMAND
from penumbra_service.engine.local import NoDeviceError, list_devices
from penumbra_service.settings import SettingsError

log = logging.getLogger(__name__)

WORKER: Final = (sys.executable, "-m", "penumbra_service.engine.dask.worker")
WAITS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Seconds before a process that ended is started again: the first, second ... time in a row."""
STEADY_SECONDS: Final = 30.0
"""A process that ran so long begins a new row."""
SELFTEST: Final = (sys.executable, "-m", "penumbra_kernels.hardcases")
SELFTEST_SECONDS: Final = 1800.0
LEAVE_SECONDS: Final = 10.0
TICK_SECONDS: Final = 0.1


@dataclass(frozen=True)
class WorkerOptions:
    """What `penumbra worker` was told."""

    scheduler: str
    tls: Path | None = None
    devices: tuple[str, ...] = ()
    """Empty: all."""
    name: str = ""
    host: str | None = None
    """Address that other machines reach this one by; None: found out."""
    port: int = 0
    status_port: int = 0
    """Of /health and metrics on loopback, for the first device; the next for the next. 0: any."""
    contents: str | None = None
    cache: Path = field(default_factory=lambda: cache.folder() / "farm")
    cache_bytes: int = 20 << 30
    device_command: tuple[str, ...] = DEVICE_COMMAND
    selftest: tuple[str, ...] = ()
    """Command that, with --device ID behind it, ends with 0 where the device may join; none: all may."""


def supervise(options: WorkerOptions) -> None:
    """Keep the workers up until SIGTERM or SIGINT. Raises SettingsError, NoDeviceError, CacheError."""
    cache.check()
    _check_cache(options.cache)
    check_scheduler(options.scheduler, options.tls)
    security(options.tls, "worker")
    devices = [device for device in _chosen(options) if _fit(device, options.selftest)]
    if not devices:
        raise NoDeviceError("no device of this machine has passed the self-test: none joins")
    leave = threading.Event()

    def told(number: int, frame: FrameType | None) -> None:
        leave.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, told)
    name = options.name or f"{socket.gethostname()}-{os.getpid()}"
    workers = [_Kept(_command(options, device, name, i)) for i, device in enumerate(devices)]
    print(f"Penumbra worker {name} drives {', '.join(devices)} for {options.scheduler}", flush=True)
    while not leave.wait(TICK_SECONDS):
        for worker in workers:
            worker.look()
    for worker in workers:
        worker.ask_to_leave()
    for worker in workers:
        worker.end()


def _check_cache(folder: Path) -> None:
    try:
        cache.check_folder(folder)
    except OSError as error:
        raise SettingsError(
            f"--cache: given {str(folder)!r}, but {error.filename or folder}: {error.strerror}; accepted: a folder, or a path "
            "where one can be made"
        ) from error


def _chosen(options: WorkerOptions) -> list[str]:
    found = [device.id for device in list_devices(options.device_command)]
    missing = sorted(set(options.devices) - set(found))
    if missing:
        raise NoDeviceError(
            f"no OpenCL device {', '.join(missing)}; this machine has: {', '.join(found) or 'none'}"
        )
    if not found:
        raise NoDeviceError("this machine has no OpenCL device")
    return list(options.devices) or found


def _fit(device: str, selftest: Sequence[str]) -> bool:
    """Whether a device passes the self-test, in a process of its own: it may crash or hang."""
    if not selftest:
        return True
    try:
        done = subprocess.run(
            [*selftest, "--device", device],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=SELFTEST_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        log.error("device %s does not join: its self-test took more than %g s", device, SELFTEST_SECONDS)
        return False
    if done.returncode != 0:
        log.error("device %s does not join: its self-test failed\n%s", device, done.stdout[-4000:])
    return done.returncode == 0


def _command(options: WorkerOptions, device: str, name: str, index: int) -> list[str]:
    words = [*WORKER, "--scheduler", options.scheduler, "--device", device, "--name", name]
    words += ["--cache", str(options.cache), "--cache-bytes", str(options.cache_bytes)]
    words += ["--parent", str(os.getpid())]
    for flag, port in (("--port", options.port), ("--status-port", options.status_port)):
        if port:
            words += [flag, str(port + index)]
    for flag, value in (("--tls", options.tls), ("--host", options.host), ("--contents", options.contents)):
        if value is not None:
            words += [flag, str(value)]
    if options.device_command != DEVICE_COMMAND:
        words += ["--device-command", *options.device_command]
    return words


class _Kept:
    """A process that is started again whenever it ends."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._began = 0.0
        self._due = 0.0
        self._row = 0

    def look(self) -> None:
        """Start it where it is due; note its end."""
        now = time.monotonic()
        if self._process is None:
            if now >= self._due:
                self._process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL)
                self._began = now
            return
        code = self._process.poll()
        if code is None:
            return
        self._row = 0 if now - self._began > STEADY_SECONDS else self._row + 1
        wait = WAITS[min(self._row, len(WAITS) - 1)]
        log.warning("a worker process ended (%d); the next starts in %g s", code, wait)
        self._process, self._due = None, now + wait

    def ask_to_leave(self) -> None:
        if self._process is not None:
            self._process.terminate()

    def end(self) -> None:
        if self._process is None:
            return
        try:
            self._process.wait(LEAVE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
