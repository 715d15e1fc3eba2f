"""Following a job by server-sent events, over broken connections, until it has ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Final

import httpx
from penumbra_scene.job import ProgressEvent

from penumbra_client import sse
from penumbra_client.errors import UnreachableError
from penumbra_client.http import Connection

SILENCE: Final = 60.0
"""Seconds without a byte after which a connection counts as broken; the service says something every 15."""
_FIRST_WAIT: Final = 0.5
_LONGEST_WAIT: Final = 10.0


def watch(
    connection: Connection, events_path: str, patience: float, sleep: Callable[[float], None] = time.sleep
) -> Iterator[ProgressEvent]:
    """A job's events up to the one that ends it.

    A broken connection is made again, from the last event that was seen. Raises UnreachableError once
    `patience` seconds of waiting have brought none back, and RefusedError where the service knows no such
    job.
    """
    parser = sse.Parser()
    wait, waited = _FIRST_WAIT, 0.0
    while True:
        try:
            for event in _once(connection, events_path, parser):
                wait, waited = _FIRST_WAIT, 0.0
                yield event
                if event.state.ended:
                    return
        except _EndSeenError:
            return
        except UnreachableError:
            if waited >= patience:
                raise
        sleep(max(wait, parser.retry_seconds or 0.0))
        waited += wait
        wait = min(2 * wait, _LONGEST_WAIT)


class _EndSeenError(Exception):
    """Status 204: the service has nothing to add to what was seen, and nobody shall come back."""


def _once(connection: Connection, path: str, parser: sse.Parser) -> Iterator[ProgressEvent]:
    """The events of one connection."""
    headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
    if parser.last_id:
        headers["Last-Event-ID"] = parser.last_id
    parser.reset()
    timeout = httpx.Timeout(SILENCE, connect=5.0)
    with connection.stream("GET", path, headers=headers, timeout=timeout) as response:
        if response.status_code == httpx.codes.NO_CONTENT:
            raise _EndSeenError
        for line in sse.lines(response.iter_bytes()):
            event = parser.feed(line)
            if event is not None and event.event == "progress":
                yield connection.read(ProgressEvent, event.data)
