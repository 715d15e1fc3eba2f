"""The process of one farm worker: `python -m penumbra_service.engine.dask.worker --scheduler URL --device ID ...`.

A Dask worker, which runs no tasks, and an agent that drives one OpenCL device in a child process. There is no Dask nanny:
`penumbra worker` (supervisor.py) starts this process, and again when it ends, which Dask's own processes do not survive when
their scheduler is killed.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from distributed import Worker
from penumbra_kernels.child import die_with

from penumbra_service import logs
from penumbra_service.engine.dask.addresses import check_scheduler, security
from penumbra_service.engine.dask.agent import Agent
from penumbra_service.engine.dask.config import settle
from penumbra_service.engine.launch import DEVICE_COMMAND
from penumbra_service.settings import SettingsError

log = logging.getLogger(__name__)

NO_DEVICE: Final = 7
"""Exit status when the device cannot be started any more."""
HEARTBEAT_SECONDS: Final = 2.0
"""A tenth of the silence after which the scheduler gives a worker up (`penumbra scheduler --worker-ttl`); the service asks by
itself, sooner."""
CONNECT_SECONDS: Final = 60.0
"""A worker looks for its scheduler so long before it ends, to be started anew."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The process's whole life; returns its exit status."""
    options = _parser().parse_args(arguments)
    if options.parent:
        die_with(options.parent)
    logs.configure_from(os.environ)
    settle()
    try:
        return asyncio.run(_work(options))
    except SettingsError as error:
        print(f"penumbra worker: {error}", file=sys.stderr)
        return 2
    except (OSError, TimeoutError) as error:
        log.warning("no scheduler at %s: %s", options.scheduler, error)
        return 4


async def _work(options: argparse.Namespace) -> int:
    scheduler = check_scheduler(options.scheduler, options.tls)
    leave, reasons = asyncio.Event(), []
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, leave.set)

    def lost(reason: str) -> None:
        reasons.append(reason)
        loop.call_soon_threadsafe(leave.set)

    agent = Agent(
        options.device,
        options.name,
        options.cache,
        cache_bytes=options.cache_bytes,
        contents=options.contents,
        command=options.device_command or DEVICE_COMMAND,
        on_lost=lost,
    )
    agent.start()
    try:
        await _serve(scheduler, options, agent, leave)
    finally:
        await asyncio.to_thread(agent.stop)
    if reasons:
        log.error("device %s is lost: %s", options.device, reasons[0])
    return NO_DEVICE if reasons else 0


class _CalmWorker(Worker):  # type: ignore[misc]
    """Tells the scheduler how it fares less often than Dask wants of small farms, which is twice a second: with all that it
    measures for the occasion it took more time than leases did."""

    async def heartbeat(self) -> None:
        await super().heartbeat()
        timer = self.periodic_callbacks["heartbeat"]
        timer.callback_time = max(timer.callback_time, HEARTBEAT_SECONDS * 1000)


async def _serve(scheduler: str, options: argparse.Namespace, agent: Agent, leave: asyncio.Event) -> None:
    """A Dask worker until it is told to leave or its scheduler is gone."""
    plain = scheduler.startswith("tcp:")
    with tempfile.TemporaryDirectory(prefix="penumbra-worker-") as folder:
        worker = _CalmWorker(
            scheduler,
            nthreads=1,
            host="127.0.0.1" if plain else options.host,
            port=options.port,
            security=security(None if plain else options.tls, "worker"),
            dashboard_address=f"127.0.0.1:{options.status_port}",  # it asks nobody who he is
            local_directory=folder,
            memory_limit=0,  # no data is kept here: nothing is to be spilled, no device to be paused
            death_timeout=CONNECT_SECONDS,
        )
        agent.join(worker)
        async with worker:
            ended = asyncio.ensure_future(worker.finished())
            told = asyncio.ensure_future(leave.wait())
            await asyncio.wait((ended, told), return_when=asyncio.FIRST_COMPLETED)
            for waiting in (ended, told):
                waiting.cancel()
            with contextlib.suppress(OSError, TimeoutError):
                await worker.close(timeout=2, executor_wait=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="worker", description="Drives one OpenCL device in a farm.")
    parser.add_argument("--scheduler", required=True)
    parser.add_argument("--tls", type=Path)
    parser.add_argument("--device", required=True)
    parser.add_argument("--name", required=True)
    parser.add_argument("--host")
    parser.add_argument("--port", default=0)
    parser.add_argument("--status-port", type=int, default=0)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--cache-bytes", type=int, required=True)
    parser.add_argument("--contents")
    parser.add_argument("--parent", type=int, default=0)
    parser.add_argument("--device-command", nargs="+", help="another device process, for tests")
    return parser


if __name__ == "__main__":
    from penumbra_service.engine.dask import worker

    sys.exit(worker.main())
