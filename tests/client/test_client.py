"""The client against a stand-in service: what it asks, and what it makes of the answers."""

from __future__ import annotations

import hashlib
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from penumbra_client import (
    Client,
    ClientError,
    JobCancelledError,
    JobFailedError,
    RefusedError,
    UnreachableError,
)
from penumbra_client.errors import NotFinishedError

SCENE = {"version": 1, "shapes": [{"type": "mesh", "source": {"file": "cup.ply"}}]}


@pytest.fixture
def client(service: Any) -> Iterator[Client]:
    with Client() as made:
        made._sleep = lambda seconds: None
        yield made


def test_files_are_uploaded_once_and_named_by_content(service: Any, client: Client, tmp_path: Path) -> None:
    (tmp_path / "cup.ply").write_bytes(b"ply\n")
    name = "sha256:" + hashlib.sha256(b"ply\n").hexdigest()
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    service.on(
        f"PUT /v1/assets/{name}",
        service.answer({"asset": name, "bytes": 4, "kind": "mesh", "format": "ply"}, 201),
    )
    twice = {**SCENE, "shapes": SCENE["shapes"] * 2}
    assert client.submit(twice, tmp_path, name="cup").id == "J1"
    (upload,) = service.requests(f"PUT /v1/assets/{name}")
    assert upload.body == b"ply\n"
    sent = service.requests("POST /v1/jobs")[0].json
    assert sent["name"] == "cup"
    assert [s["source"] for s in sent["scene"]["shapes"]] == [{"asset": name}] * 2


def test_an_asset_that_the_service_has_is_not_sent_again(
    service: Any, client: Client, tmp_path: Path
) -> None:
    (tmp_path / "cup.ply").write_bytes(b"ply\n")
    name = "sha256:" + hashlib.sha256(b"ply\n").hexdigest()
    service.on(f"HEAD /v1/assets/{name}", (200, {}, b""))
    assert client.upload(tmp_path / "cup.ply") == name
    assert service.count(f"PUT /v1/assets/{name}") == 0


def test_files_of_a_document_need_a_folder(client: Client) -> None:
    with pytest.raises(ClientError, match=r"/shapes/0/source names the file 'cup.ply'"):
        client.submit(SCENE)


def test_a_broken_submission_is_sent_again_with_the_same_key(service: Any, client: Client) -> None:
    service.on("POST /v1/jobs", (0, {}, b""), service.answer(service.job(), 202))
    assert client.submit({"version": 1}).id == "J1"
    keys = [r.headers["idempotency-key"] for r in service.requests("POST /v1/jobs")]
    assert len(keys) == 2
    assert keys[0] == keys[1]


def test_two_submissions_have_two_keys(service: Any, client: Client) -> None:
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    client.submit({"version": 1})
    client.submit({"version": 1})
    assert len({r.headers["idempotency-key"] for r in service.requests("POST /v1/jobs")}) == 2


def test_a_problem_is_told_with_its_places(service: Any, client: Client) -> None:
    error = {
        "pointer": "/scene/camera/fov",
        "message": "must be less than 180",
        "given": "200",
        "accepted": "<180",
    }
    service.on("POST /v1/jobs", service.problem(422, "The job is not valid", "1 error", [error]))
    with pytest.raises(
        RefusedError, match="at /scene/camera/fov: must be less than 180; given 200"
    ) as caught:
        client.submit({"version": 1})
    assert caught.value.problem.errors[0].accepted == "<180"
    assert caught.value.exit_code == 3


def test_an_answer_that_is_no_problem_document_is_still_told(service: Any, client: Client) -> None:
    service.on("GET /health", (502, {"Content-Type": "text/html"}, b"<h1>Bad Gateway</h1>"))
    with pytest.raises(RefusedError, match="502 Bad Gateway") as caught:
        client.health()
    assert caught.value.exit_code == 8


def test_a_service_that_is_not_there_is_unreachable() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{free.getsockname()[1]}"
        with Client(address) as client, pytest.raises(UnreachableError, match="penumbra serve"):
            client.health()


@pytest.mark.parametrize("address", ["127.0.0.1:8484", "ftp://host", "http://", "http://host:port", ""])
def test_what_is_no_address_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PENUMBRA_SERVER", address or "nonsense")
    with pytest.raises(ClientError, match="accepted: http://host:port"):
        Client(address)


def test_keys_that_a_newer_service_adds_are_ignored(service: Any, client: Client) -> None:
    service.on("GET /v1/jobs/J1", service.answer(service.job(brand_new={"x": 1})))
    assert client.job("J1").state == "queued"


def test_another_service_on_the_port_is_recognised(service: Any, client: Client) -> None:
    service.on("GET /health", service.answer({"hello": "world"}))
    with pytest.raises(ClientError, match="speaks another API"):
        client.health()


@pytest.mark.parametrize("job_id", ["", "../keys", "a/b", "a?b", "a b"])
def test_a_job_id_is_no_path(job_id: str, service: Any, client: Client) -> None:
    with pytest.raises(ClientError, match="is no job id"):
        client.job(job_id)
    assert service.asked == []


def test_the_key_is_sent_where_there_is_one(service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    service.on("GET /v1/jobs/J1", service.answer(service.job()))
    monkeypatch.setenv("PENUMBRA_API_KEY", "secret")
    with Client() as client:
        client.job("J1")
    assert service.asked[0].headers["authorization"] == "Bearer secret"


def test_proxies_are_not_asked_for_this_machine(service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    service.on("GET /v1/jobs/J1", service.answer(service.job()))
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")  # the discard port: nothing answers
    with Client() as client:
        assert client.job("J1").id == "J1"


def test_all_pages_of_the_list_are_read(service: Any, client: Client) -> None:
    first = service.answer({"items": [service.job(id="A"), service.job(id="B")], "next": "B"})
    service.on("GET /v1/jobs", first, service.answer({"items": [service.job(id="C")]}))
    assert [j.id for j in client.jobs(["done", "failed"])] == ["A", "B", "C"]
    one, two = service.requests("GET /v1/jobs")
    assert "state=done&state=failed" in one.path
    assert "cursor=B" in two.path


def test_a_limited_list_asks_for_no_more(service: Any, client: Client) -> None:
    service.on(
        "GET /v1/jobs", service.answer({"items": [service.job(id="A"), service.job(id="B")], "next": "B"})
    )
    assert [j.id for j in client.jobs(limit=2)] == ["A", "B"]
    assert service.count("GET /v1/jobs") == 1


def test_watching_goes_on_after_a_broken_connection(service: Any, client: Client) -> None:
    service.on(
        "GET /v1/jobs/J1/events",
        service.stream(service.event("rendering", progress=0.25), service.event("rendering", progress=0.5)),
        (0, {}, b""),
        service.stream(service.event("done", progress=1.0), first_id=3),
    )
    assert [e.progress for e in client.watch("J1")] == [0.25, 0.5, 1.0]
    ids = [r.headers.get("last-event-id") for r in service.requests("GET /v1/jobs/J1/events")]
    assert ids == [None, "2", "2"]


def test_half_an_event_is_forgotten_when_the_connection_breaks(service: Any, client: Client) -> None:
    whole = service.stream(service.event("rendering", progress=0.5))
    half = (whole[0], whole[1], whole[2] + b"id: 2\nevent: progress\ndata: {broken")
    service.on("GET /v1/jobs/J1/events", half, service.stream(service.event("done"), first_id=2))
    assert [e.state for e in client.watch("J1")] == ["rendering", "done"]


def test_watching_waits_as_long_as_it_has_patience(service: Any) -> None:
    service.on("GET /v1/jobs/J1/events", (0, {}, b""))
    waits: list[float] = []
    with Client() as client:
        client._sleep = waits.append
        with pytest.raises(UnreachableError):
            list(client.watch("J1", patience=5.0))
    # 0.5 + 1 + 2 is not 5 yet, 0.5 + 1 + 2 + 4 is.
    assert waits == [0.5, 1.0, 2.0, 4.0]


def test_the_server_decides_how_soon_to_come_back(service: Any) -> None:
    status, headers, body = service.stream(service.event("rendering"))
    service.on(
        "GET /v1/jobs/J1/events",
        (status, headers, b"retry: 3000\n" + body),
        service.stream(service.event("done")),
    )
    waits: list[float] = []
    with Client() as client:
        client._sleep = waits.append
        list(client.watch("J1"))
    assert waits == [3.0]


def test_other_events_of_the_stream_are_passed_over(service: Any, client: Client) -> None:
    status, headers, body = service.stream(service.event("done"))
    service.on("GET /v1/jobs/J1/events", (status, headers, b"event: weather\ndata: rain\n\n" + body))
    assert [e.state for e in client.watch("J1")] == ["done"]


def test_a_stream_that_has_nothing_more_is_not_asked_again(service: Any, client: Client) -> None:
    service.on(
        "GET /v1/jobs/J1/events", service.stream(service.event("rendering", progress=1.0)), (204, {}, b"")
    )
    assert [e.progress for e in client.watch("J1")] == [1.0]
    assert service.count("GET /v1/jobs/J1/events") == 2


def test_watching_an_unknown_job_ends_at_once(client: Client) -> None:
    with pytest.raises(RefusedError, match="Not found"):
        list(client.watch("J1"))


def test_waiting_ends_as_the_job_does(service: Any, client: Client) -> None:
    service.on("GET /v1/jobs/J1/events", service.stream(service.event("failed")))
    why = {
        "type": "about:blank",
        "title": "The device is lost",
        "status": 500,
        "detail": "it crashed 3 times",
    }
    service.on(
        "GET /v1/jobs/J1",
        service.answer(service.job("failed", problem=why)),
        service.answer(service.job("cancelled")),
    )
    with pytest.raises(JobFailedError, match="The device is lost: it crashed 3 times") as failed:
        client.wait("J1")
    with pytest.raises(JobCancelledError) as cancelled:
        client.wait("J1")
    assert (failed.value.exit_code, cancelled.value.exit_code) == (5, 6)


def test_results_are_fetched_under_their_names(service: Any, client: Client, tmp_path: Path) -> None:
    service.on("GET /v1/jobs/J1", service.answer(service.job("done")))
    for name in ("result.exr", "thumbnail.png", "heatmap.png", "receipt.json"):
        service.on(f"GET /v1/jobs/J1/{name}", (200, {}, name.encode()))
    paths = client.fetch("J1", tmp_path / "new" / "out")
    assert {name: path.read_text() for name, path in paths.items()} == {
        "exr": "result.exr",
        "thumbnail": "thumbnail.png",
        "heatmap": "heatmap.png",
        "receipt": "receipt.json",
    }
    assert sorted(p.name for p in (tmp_path / "new" / "out").iterdir()) == sorted(
        ["result.exr", "thumbnail.png", "heatmap.png", "receipt.json"]
    )


def test_frames_are_fetched_into_folders_of_their_own(service: Any, client: Client, tmp_path: Path) -> None:
    sheet, movie = "/v1/jobs/J1/contact_sheet.png", "/v1/jobs/J1/preview.mp4"
    job = service.job("rendering", frames={"total": 3, "done": 2})
    job["links"] |= {"frames": "/v1/jobs/J1/frames", "contact_sheet": sheet, "movie": movie}
    service.on("GET /v1/jobs/J1", service.answer(job))

    def frame(number: int, state: str) -> dict[str, Any]:
        base = f"/v1/jobs/J1/frames/{number}"
        names = {
            "exr": "result.exr",
            "thumbnail": "thumbnail.png",
            "heatmap": "heatmap.png",
            "receipt": "receipt.json",
        }
        for name in names.values():
            service.on(f"GET {base}/{name}", (200, {}, f"{number} {name}".encode()))
        links = {"self": base, **{key: f"{base}/{name}" for key, name in names.items()}}
        return {"number": number, "time": number / 24, "state": state, "links": links}

    pages = [
        {"items": [frame(1, "done"), frame(2, "rendering")], "next": 2},
        {"items": [frame(12345, "done")], "next": None},
    ]
    service.on("GET /v1/jobs/J1/frames", *(service.answer(page) for page in pages))
    service.on(f"GET {sheet}", (200, {}, b"sheet"))
    paths = client.fetch("J1", tmp_path, ["exr", "receipt"])
    assert paths == {"frames": tmp_path / "frames", "contact_sheet": tmp_path / "contact_sheet.png"}
    found = {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    assert found == {
        "frames/0001/result.exr": "1 result.exr",
        "frames/0001/receipt.json": "1 receipt.json",
        "frames/12345/result.exr": "12345 result.exr",
        "frames/12345/receipt.json": "12345 receipt.json",
        "contact_sheet.png": "sheet",
    }


def test_a_broken_download_leaves_the_old_file(service: Any, client: Client, tmp_path: Path) -> None:
    (tmp_path / "result.exr").write_text("old")
    service.on("GET /v1/jobs/J1", service.answer(service.job("done")))
    service.on("GET /v1/jobs/J1/result.exr", (200, {"Content-Length": "100"}, b"half"))
    with pytest.raises(UnreachableError):
        client.fetch("J1", tmp_path, ["exr"])
    assert [p.name for p in tmp_path.iterdir()] == ["result.exr"]
    assert (tmp_path / "result.exr").read_text() == "old"


def test_results_of_an_unfinished_job_are_said_to_be_missing(
    service: Any, client: Client, tmp_path: Path
) -> None:
    service.on("GET /v1/jobs/J1", service.answer(service.job("rendering")))
    with pytest.raises(NotFinishedError, match=r"job J1 is rendering and has no result.exr yet"):
        client.fetch("J1", tmp_path, ["exr"])


def test_a_folder_that_cannot_be_written_is_told(service: Any, client: Client, tmp_path: Path) -> None:
    service.on("GET /v1/jobs/J1", service.answer(service.job("done")))
    (tmp_path / "file").touch()
    with pytest.raises(ClientError, match=r"cannot write .*file/out: Not a directory"):
        client.fetch("J1", tmp_path / "file" / "out", ["exr"])
