"""`penumbra serve`: a socket, the application behind it, and a clean end."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Final

import uvicorn
from penumbra_scene.exits import Exit

from penumbra_service import logs
from penumbra_service.app import create_app
from penumbra_service.engine.launch import Child
from penumbra_service.http_heads import HeadTimedProtocol
from penumbra_service.local_runner import LocalRunner, engine_of
from penumbra_service.settings import Settings, SettingsError

log = logging.getLogger(__name__)

_GRACE_SECONDS: Final = 5
"""After this, connections that a stop finds open are cut off."""
LOCK: Final = "service.lock"


def serve(settings: Settings, first: Child | None = None) -> int:
    """Run until a signal comes; returns the exit status. `first`: this machine's first device process, if it was started ahead.

    Raises SettingsError where the settings do not go together, OSError where the address cannot be had.
    """
    logs.configure(settings.log_level, settings.log_format)
    # On a database of its own each service must be alone; on a shared one they hold jobs, and may share the folder.
    alone = contextlib.nullcontext() if settings.shared else sole_user(settings.data)
    with listen(settings.host, settings.port) as listening, alone:
        config = uvicorn.Config(
            create_app(settings, LocalRunner(settings, engine_of(settings, first))),
            log_config=None,
            access_log=settings.log_level == "debug",
            timeout_graceful_shutdown=_GRACE_SECONDS,
            server_header=False,
            http=HeadTimedProtocol,
        )
        return _run(_Server(config), listening)


def listen(host: str, port: int) -> socket.socket:
    """A bound socket: with port 0 a free port is found, and it stays ours. Raises OSError."""
    found = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, kind, protocol, _, address = found[0]
    listening = socket.socket(family, kind, protocol)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
    except OSError:
        listening.close()
        raise
    return listening


@contextlib.contextmanager
def sole_user(data: Path) -> Iterator[None]:
    """Holds the data folder: two services would run the same jobs. Raises SettingsError where one is up."""
    data.mkdir(parents=True, exist_ok=True)
    with (data / LOCK).open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SettingsError(f"data: given {data}, which another running service uses") from None
        except OSError as error:  # a file system without locks
            log.warning("cannot lock %s (%s): let no other service use it", data, error)
        yield


def url_of(listening: socket.socket) -> str:
    """The address that a browser on this machine takes."""
    host, port = listening.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


class _Server(uvicorn.Server):
    """Says where it listens once it does: whoever started it waits for that line."""

    failed = False
    """Whether the application could not start; its log says why."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.failed = self.lifespan.should_exit
        for listening in () if self.failed else sockets or ():
            print(f"Penumbra listens on {url_of(listening)}", flush=True)


def _run(server: _Server, listening: socket.socket) -> int:
    # uvicorn raises the signal that stopped it once more when it is done: that is then a normal end.
    signal.signal(signal.SIGTERM, _leave)
    with contextlib.suppress(KeyboardInterrupt):
        try:
            server.run(sockets=[listening])
        except SystemExit as leaving:
            return Exit.OK if leaving.code == Exit.OK else Exit.INTERNAL
    return Exit.INTERNAL if server.failed else Exit.OK


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(Exit.OK)
