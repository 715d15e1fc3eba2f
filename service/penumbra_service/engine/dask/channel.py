"""The connection on which a service gives one worker its leases and hears the answers: plain picklable values, both ways.

It is one of Dask's own (its TLS, its framing; arrays travel without being copied into a pickle) and goes straight from the
service to the worker. A lease as a Dask task would pass the scheduler three times and the state machines of client, scheduler
and worker, which decide nothing here and cost more than the answer's bytes (decision 23).
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

from distributed.comm import Comm, connect
from distributed.protocol import to_serialize

OPERATION: Final = "penumbra_leases"
"""What a service asks a worker's Dask server for."""
_VALUE: Final = "value"


class Channel:
    """One end. Of one event loop."""

    def __init__(self, comm: Comm) -> None:
        self._comm = comm
        self._sending = asyncio.Lock()

    async def send(self, value: object) -> None:
        """Values arrive whole and in order. Raises OSError where the other end has gone."""
        async with self._sending:
            await self._comm.write({_VALUE: to_serialize(value)}, on_error="raise")

    async def receive(self) -> Any:
        """The next value. Raises OSError where the other end has gone, or has failed and says how."""
        message = await self._comm.read()
        if isinstance(message, dict) and _VALUE in message:
            return message[_VALUE]
        said = message.get("exception_text") if isinstance(message, dict) else None
        raise ConnectionError(said or "it is no worker of this version of Penumbra")

    def abort(self) -> None:
        """End it at once."""
        self._comm.abort()


async def open_channel(address: str, connection_args: dict[str, Any]) -> Channel:
    """To a worker, by its Dask address. `connection_args`: Client.connection_args. Raises OSError."""
    comm = await connect(address, **connection_args)
    await comm.write({"op": OPERATION})
    return Channel(comm)
