"""Bodies have an end on every route, forms and the log-in page included."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_service.api import limits
from penumbra_service.api.limits import FORM_BYTES, LOGIN_BYTES
from penumbra_service.app import create_app
from penumbra_service.serve import create_key
from penumbra_service.settings import Settings

LIMIT = 1000
MOST = 2 * LIMIT + FORM_BYTES
FORM = {"Content-Type": "application/x-www-form-urlencoded"}


@pytest.fixture
def small(tmp_path: Path, runner: Any) -> Iterator[TestClient]:
    settings = Settings(data=tmp_path, max_body_bytes=LIMIT)
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        yield client


def pieces(size: int) -> Iterator[bytes]:
    """A body whose length is not announced."""
    while size > 0:
        yield b"x" * min(size, 4096)
        size -= 4096


def refused(answer: Any) -> None:
    assert answer.status_code == 413
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("announced", [True, False])
def test_a_form_with_a_long_file_is_refused(small: TestClient, announced: bool) -> None:
    head = b'--b\r\nContent-Disposition: form-data; name="file"; filename="scene.json"\r\n\r\n'
    body = head + b" " * MOST + b"\r\n--b--\r\n"
    content = body if announced else (body[i : i + 5000] for i in range(0, len(body), 5000))
    refused(
        small.post("/submit", content=content, headers={"Content-Type": "multipart/form-data; boundary=b"})
    )


@pytest.mark.parametrize("announced", [True, False])
def test_a_route_that_changes_a_job_refuses_a_long_body(
    small: TestClient, scene: dict[str, Any], announced: bool
) -> None:
    job = small.post("/v1/jobs", json=scene).json()["id"]
    size = MOST + 1
    content = b" " * size if announced else pieces(size)
    headers = {"Content-Type": "application/json"}
    refused(small.patch(f"/v1/jobs/{job}", content=content, headers=headers))


@pytest.mark.parametrize("announced", [True, False])
def test_the_log_in_page_reads_little_from_strangers(tmp_path: Path, runner: Any, announced: bool) -> None:
    create_key("one", tmp_path)
    with TestClient(create_app(Settings(data=tmp_path), runner), base_url="http://127.0.0.1") as client:
        content = b"key=" + b"x" * LOGIN_BYTES if announced else pieces(LOGIN_BYTES + 1)
        refused(client.post("/login", content=content, headers=FORM))
        assert client.post("/login", content=b"key=wrong", headers=FORM).status_code == 401


def test_assets_keep_their_own_limit(small: TestClient) -> None:
    corners = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    comment = b"# " + b"x" * MOST + b"\n"
    assert small.post("/v1/assets", content=comment + corners).status_code == 201


def answer(app: Any, path: str, messages: list[dict[str, Any]]) -> int:
    """The status of a POST whose body comes in these messages, and then no more."""
    left, sent = list(messages), []

    async def receive() -> dict[str, Any]:
        if not left:
            await asyncio.sleep(60)
        return left.pop(0)

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    kind = b"application/json" if path.startswith("/v1") else FORM["Content-Type"].encode()
    headers = [(b"host", b"127.0.0.1"), (b"content-type", kind), (b"content-length", b"900")]
    scope = {"type": "http", "method": "POST", "path": path, "query_string": b"", "headers": headers}
    asyncio.run(
        app({**scope, "http_version": "1.1", "scheme": "http", "server": ("127.0.0.1", 80)}, receive, send)
    )
    return int(sent[0]["status"])


BEGUN = {"type": "http.request", "body": b"{", "more_body": True}


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/assets", "/submit", "/login"])
def test_a_body_that_stalls_is_given_up(
    small: TestClient, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    monkeypatch.setattr(limits, "STALL_SECONDS", 0.1)
    assert answer(small.app, path, [BEGUN]) == 408


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/assets"])
def test_a_caller_who_leaves_is_no_error_of_the_service(
    small: TestClient, caplog: pytest.LogCaptureFixture, path: str
) -> None:
    with caplog.at_level("INFO"):
        answer(small.app, path, [BEGUN, {"type": "http.disconnect"}])
    assert [record.levelname for record in caplog.records] == ["INFO"]
    assert "the caller left" in caplog.text
    folder: Path = small.app.state.service.settings.assets_folder  # type: ignore[attr-defined]
    assert list(folder.iterdir()) == []
