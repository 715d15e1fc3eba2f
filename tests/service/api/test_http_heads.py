"""A client that never finishes the head of its request is cut off; whoever waits for an answer is not."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import uvicorn
from penumbra_service import http_heads
from penumbra_service.http_heads import HeadTimedProtocol

HEAD_SECONDS = 0.3
ANSWER_SECONDS = 1.0
GET = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


async def _answer(scope: Any, receive: Any, send: Any) -> None:
    """Slowly."""
    await asyncio.sleep(ANSWER_SECONDS)
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


@pytest.fixture
def connect(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], socket.socket]]:
    """connect(): a connection to a server at work."""
    monkeypatch.setattr(http_heads, "HEAD_SECONDS", HEAD_SECONDS)
    config = uvicorn.Config(
        _answer, lifespan="off", log_config=None, log_level="critical", http=HeadTimedProtocol
    )
    server = uvicorn.Server(config)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        opened = []

        def connect() -> socket.socket:
            opened.append(socket.create_connection(listening.getsockname(), timeout=30))
            return opened[-1]

        try:
            yield connect
        finally:
            for connection in opened:
                connection.close()
            server.should_exit = True
            thread.join()


def _ended(connection: socket.socket) -> bool:
    """Waits for the other side to close."""
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


@pytest.mark.parametrize("first", [b"", b"GET / HTTP/1.1\r\nHost: x\r\nX-Slow: "])
def test_a_head_that_does_not_end_is_cut_off(connect: Callable[[], socket.socket], first: bytes) -> None:
    connection = connect()
    connection.sendall(first)
    assert _ended(connection)


def test_a_head_that_comes_by_drops_is_cut_off(connect: Callable[[], socket.socket]) -> None:
    connection = connect()
    connection.sendall(b"GET / HTTP/1.1\r\n")
    connection.settimeout(0.05)
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            connection.sendall(b"X-More: 1\r\n")
            if connection.recv(1) == b"":
                return
        except TimeoutError:
            continue
        except ConnectionError:
            return
    raise AssertionError("it was kept up")


def test_an_answer_may_take_longer_than_a_head_and_a_second_head_is_watched_too(
    connect: Callable[[], socket.socket],
) -> None:
    connection = connect()
    for _ in range(2):
        connection.sendall(GET)
        answer = b""
        while not answer.endswith(b"ok"):
            more = connection.recv(4096)
            assert more, "cut off before it was answered"
            answer += more
        assert answer.startswith(b"HTTP/1.1 200")
    connection.sendall(GET[:10])
    assert _ended(connection)
