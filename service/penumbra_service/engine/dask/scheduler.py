"""`penumbra scheduler`: a Dask scheduler that may only be reached by whoever shows a certificate, or on loopback.

Dask's own command listens on every interface and asks nobody who he is; whoever reaches it runs code.
"""

from __future__ import annotations

import asyncio
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from distributed import Scheduler

from penumbra_service import logs
from penumbra_service.engine.dask.addresses import DEFAULT_PORT, security
from penumbra_service.engine.dask.config import settle
from penumbra_service.settings import SettingsError, is_loopback

STATUS_PORT: Final = 8787
CONFIG: Final = {"distributed.scheduler.work-stealing": False}
"""There are no tasks to be stolen."""

USELESS: Final = ("idle-timeout", "no-workers-timeout")
"""What looks four times a second whether tasks have been missing for too long."""


@dataclass(frozen=True)
class SchedulerOptions:
    """What `penumbra scheduler` was told."""

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    tls: Path | None = None
    status_port: int = STATUS_PORT
    """On loopback: /health and Prometheus metrics."""
    worker_ttl: float = 20.0
    """Seconds of silence after which a worker is given up."""


def serve_scheduler(options: SchedulerOptions) -> None:
    """Run until SIGTERM or SIGINT. Raises SettingsError, OSError where the address cannot be had."""
    if options.tls is None and not is_loopback(options.host):
        raise SettingsError(
            f"tls: none given, and other machines can reach the host {options.host!r}: whoever reaches a scheduler "
            "without TLS runs code on every worker; accepted: --tls FOLDER (`penumbra certs` makes it), or --host "
            "127.0.0.1"
        )
    logs.configure_from(os.environ)
    settle(**CONFIG, **{"distributed.scheduler.worker-ttl": f"{options.worker_ttl} s"})
    asyncio.run(_serve(options))


async def _serve(options: SchedulerOptions) -> None:
    leave = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, leave.set)
    scheduler = Scheduler(
        host=options.host,
        port=options.port,
        protocol="tls" if options.tls else "tcp",
        security=security(options.tls, "scheduler"),
        dashboard_address=f"127.0.0.1:{options.status_port}",
        dashboard=False,
    )
    for name in USELESS:
        scheduler.periodic_callbacks.pop(name, None)
    async with scheduler:
        print(f"Penumbra scheduler listens on {scheduler.address}", flush=True)
        ended = asyncio.ensure_future(scheduler.finished())
        told = asyncio.ensure_future(leave.wait())
        await asyncio.wait((ended, told), return_when=asyncio.FIRST_COMPLETED)
        for waiting in (ended, told):
            waiting.cancel()
