"""Makes a plain Dask worker a worker of a farm: `dask worker URL --preload penumbra_service.engine.dask.preload`.

For launchers that start Dask's own workers, such as dask-jobqueue; elsewhere `penumbra worker` is the way. Give it
--no-nanny. PENUMBRA_DEVICES names the OpenCL device (default: the machine's first),
PENUMBRA_ARTIFACTS_URL the artifact store where leases name it otherwise than it is reached from here.
"""

from __future__ import annotations

import asyncio
import logging
import os
from typing import Final

from distributed import Worker
from penumbra_kernels import cache

from penumbra_service.engine.dask.agent import Agent
from penumbra_service.engine.local import NoDeviceError, list_devices
from penumbra_service.store.contents import contents_url

log = logging.getLogger(__name__)

CACHE_BYTES: Final = 20 << 30
_AGENTS: Final[dict[str, Agent]] = {}


async def dask_setup(worker: Worker) -> None:
    """Dask calls it before the worker joins. Raises NoDeviceError, CacheError."""
    cache.check()
    found = await asyncio.to_thread(list_devices)
    wanted = os.environ.get("PENUMBRA_DEVICES") or (found[0].id if found else "")
    if wanted not in {device.id for device in found}:
        have = ", ".join(device.id for device in found) or "none"
        raise NoDeviceError(
            f"PENUMBRA_DEVICES: given {wanted!r}, accepted: one of this machine's devices ({have})"
        )
    store = os.environ.get("PENUMBRA_ARTIFACTS_URL")

    def lost(reason: str) -> None:
        log.error("device %s is lost: %s", wanted, reason)
        worker.loop.add_callback(worker.close)

    agent = Agent(
        wanted,
        str(worker.name),
        cache.folder() / "farm",
        cache_bytes=CACHE_BYTES,
        contents=contents_url(store) if store else None,
        on_lost=lost,
    )
    agent.start()
    agent.join(worker)
    _AGENTS[worker.id] = agent


async def dask_teardown(worker: Worker) -> None:
    """Dask calls it when the worker leaves."""
    agent = _AGENTS.pop(worker.id, None)
    if agent is not None:
        await asyncio.to_thread(agent.stop)
