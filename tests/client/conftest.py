"""A stand-in for the service: real sockets, answers that a test lays out, and a record of what was asked."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest


@dataclass(frozen=True)
class Asked:
    """One request as it arrived."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


Answer = tuple[int, dict[str, str], bytes]
"""Status, headers, body. A status of 0 closes the connection without an answer."""


def answer(document: Any, status: int = 200) -> Answer:
    """A JSON answer."""
    return status, {"Content-Type": "application/json"}, json.dumps(document).encode()


def problem(status: int, title: str, detail: str = "", errors: Any = ()) -> Answer:
    """A problem+json answer."""
    document = {
        "type": "urn:problem-type:penumbra:test",
        "title": title,
        "status": status,
        "detail": detail,
        "errors": list(errors),
    }
    return status, {"Content-Type": "application/problem+json"}, json.dumps(document).encode()


def stream(*events: dict[str, Any], first_id: int = 1) -> Answer:
    """Server-sent progress events, then the end of the connection."""
    text = "".join(
        f"id: {number}\nevent: progress\ndata: {json.dumps(event)}\n\n"
        for number, event in enumerate(events, first_id)
    )
    return 200, {"Content-Type": "text/event-stream"}, text.encode()


def job(state: str = "queued", **changes: Any) -> dict[str, Any]:
    """A job as the service tells it."""
    path = "/v1/jobs/J1"
    links = {
        "self": path,
        "exr": f"{path}/result.exr",
        "thumbnail": f"{path}/thumbnail.png",
        "heatmap": f"{path}/heatmap.png",
        "receipt": f"{path}/receipt.json",
        "events": f"{path}/events",
        "page": "/jobs/J1",
    }
    return {
        "id": "J1",
        "name": "test",
        "state": state,
        "created": "2025-01-01T00:00:00Z",
        "width": 8,
        "height": 8,
        "sampler": "sobol",
        "stop": {"samples": 4},
        "links": links,
        **changes,
    }


def event(state: str, **changes: Any) -> dict[str, Any]:
    """A progress event's data."""
    return {"id": "J1", "state": state, **changes}


@dataclass
class FakeService:
    """Answers each "METHOD path" with its next answer; the last one is repeated."""

    address: str
    answers: dict[str, list[Answer]] = field(default_factory=dict)
    asked: list[Asked] = field(default_factory=list)

    answer = staticmethod(answer)
    problem = staticmethod(problem)
    stream = staticmethod(stream)
    job = staticmethod(job)
    event = staticmethod(event)

    def on(self, what: str, *answers: Answer) -> None:
        """Lay out answers."""
        self.answers[what] = list(answers)

    def count(self, what: str) -> int:
        """How often it was asked."""
        return len(self.requests(what))

    def requests(self, what: str) -> list[Asked]:
        """All requests of one kind."""
        return [a for a in self.asked if f"{a.method} {a.path.partition('?')[0]}" == what]

    def next_answer(self, asked: Asked) -> Answer:
        self.asked.append(asked)
        waiting = self.answers.get(f"{asked.method} {asked.path.partition('?')[0]}")
        if not waiting:
            return problem(404, "Not found", asked.path)
        return waiting.pop(0) if len(waiting) > 1 else waiting[0]


def _read_body(handler: BaseHTTPRequestHandler) -> bytes:
    if handler.headers.get("Transfer-Encoding") != "chunked":
        return handler.rfile.read(int(handler.headers.get("Content-Length") or 0))
    body = b""
    while size := int(handler.rfile.readline(), 16):
        body += handler.rfile.read(size)
        handler.rfile.readline()
    handler.rfile.readline()
    return body


def _handler(next_answer: Callable[[Asked], Answer]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def _answer(self) -> None:
            body = _read_body(self)
            status, headers, content = next_answer(
                Asked(self.command, self.path, {k.lower(): v for k, v in self.headers.items()}, body)
            )
            self.close_connection = True
            if status == 0:
                return
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(content)

        do_GET = do_POST = do_PUT = do_HEAD = _answer  # noqa: N815 - names that http.server calls

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as the base class has it
            pass

    return Handler


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeService]:
    """A service on a free port of this machine, which PENUMBRA_SERVER points at."""
    fake = FakeService("")
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(fake.next_answer))
    fake.address = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setenv("PENUMBRA_SERVER", fake.address)
    monkeypatch.delenv("PENUMBRA_API_KEY", raising=False)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield fake
    server.shutdown()
    thread.join()
    server.server_close()
