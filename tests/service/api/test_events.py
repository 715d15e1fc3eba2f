"""Streams of events."""

from __future__ import annotations

import threading
from typing import Any

from fastapi.testclient import TestClient
from penumbra_scene.job import ProgressEvent


def parse(text: str) -> list[dict[str, str]]:
    """Events as dictionaries of their fields; comments are kept under ''."""
    events = []
    for block in text.replace("\r\n", "\n").split("\n\n"):
        fields: dict[str, str] = {}
        for line in block.splitlines():
            name, _, value = line.partition(":")
            fields[name] = value.strip()
        if fields:
            events.append(fields)
    return events


def test_a_stream_tells_the_whole_way_and_ends_with_the_job(
    client: TestClient, scene: dict[str, Any], runner: Any
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    threading.Timer(0.1, runner.let).start()
    answer = client.get(job["links"]["events"])
    assert answer.headers["content-type"].startswith("text/event-stream")
    events = [event for event in parse(answer.text) if "data" in event]
    assert {event["event"] for event in events} == {"progress"}
    told = [ProgressEvent.model_validate_json(event["data"]) for event in events]
    assert told[-1].state == "done"
    assert told[-1].stop_reason == "samples"
    assert all(not event.state.ended for event in told[:-1])
    assert [e.progress for e in told] == sorted(e.progress for e in told)
    ids = [int(event["id"]) for event in events]
    assert ids == sorted(set(ids))
    assert all(event.id == job["id"] for event in told)


def test_a_client_that_comes_back_gets_only_what_is_new(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    runner.let()
    wait_for(job["id"], "done")
    all_of_it = parse(client.get(job["links"]["events"]).text)
    last = all_of_it[-1]["id"]
    earlier = client.get(job["links"]["events"], headers={"Last-Event-ID": str(int(last) - 1)})
    assert [event["id"] for event in parse(earlier.text)] == [last]
    nothing_new = client.get(job["links"]["events"], headers={"Last-Event-ID": last})
    assert nothing_new.status_code == 204
    assert client.get(job["links"]["events"], headers={"Last-Event-ID": "x"}).status_code == 200


def test_a_quiet_stream_shows_that_it_lives(client: TestClient, scene: dict[str, Any], runner: Any) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    threading.Timer(1.6, runner.let).start()
    answer = client.get(job["links"]["events"])
    assert any(line.startswith(":") for line in answer.text.splitlines())


def test_cancelling_ends_the_stream(client: TestClient, scene: dict[str, Any], wait_for: Any) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    wait_for(job["id"], "rendering")
    service = client.app.state.service  # type: ignore[attr-defined]
    threading.Timer(0.1, service.cancel, (job["id"],)).start()
    events = parse(client.get(job["links"]["events"]).text)
    assert ProgressEvent.model_validate_json(events[-1]["data"]).state == "cancelled"
