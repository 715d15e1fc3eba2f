"""HTTP connections whose client must come to the point: one that does not finish the head of a request is cut off.

uvicorn watches connections that rest between two requests, and api.limits watches bodies. What nobody watches, a client can
hold open for ever: a connection on which nothing comes, or a head that never ends.
"""

from __future__ import annotations

import asyncio
from typing import Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_SECONDS: Final = 20.0
"""From the connection, or from the first bytes of a further request, to the end of the head."""


class HeadTimedProtocol(H11Protocol):
    """uvicorn's, with a clock on heads."""

    _due: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        self._rest()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state is h11.IDLE:  # these bytes did not end it
            self._watch()
        else:
            self._rest()

    def _watch(self) -> None:
        if self._due is None:
            self._due = self.loop.call_later(HEAD_SECONDS, self._cut)

    def _rest(self) -> None:
        if self._due is not None:
            self._due.cancel()
            self._due = None

    def _cut(self) -> None:
        self._due = None
        self.transport.close()
