"""The life of a job over HTTP, with a runner that renders nothing."""

from __future__ import annotations

import json
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_scene.job import JobPage, JobStatus, Validation
from penumbra_scene.parse import parse_json
from penumbra_service import job_queue
from penumbra_service.app import create_app


def test_a_submitted_job_is_accepted_and_has_a_place(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.post("/v1/jobs", json={"scene": scene, "priority": 3})
    assert answer.status_code == 202
    status = JobStatus.model_validate_json(answer.content)
    assert answer.headers["location"] == f"/v1/jobs/{status.id}"
    assert (status.name, status.priority, status.width, status.height) == ("a quad", 3, 32, 24)
    assert client.get(answer.headers["location"]).json()["id"] == status.id


def test_a_bare_scene_makes_a_job(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.post("/v1/jobs", json=scene)
    assert answer.status_code == 202
    assert client.get(answer.json()["links"]["self"] + "/scene.json").json()["name"] == "a quad"


def test_a_job_runs_to_its_end_and_leaves_its_files(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    links = client.post("/v1/jobs", json=scene).json()["links"]
    job_id = links["self"].rsplit("/", 1)[1]
    missing = client.get(links["exr"])
    assert missing.status_code == 404
    assert missing.headers["content-type"] == "application/problem+json"
    runner.let()
    status = wait_for(job_id, "done")
    assert status["stop_reason"] == "samples"
    assert status["progress"] == 1.0
    assert status["samples_done"] == 40.0
    assert status["devices"] == ["fake-0"]
    assert status["finished"] >= status["started"] >= status["created"]
    assert client.get(links["exr"]).content == b"exr" * 1000
    assert client.get(links["exr"]).headers["content-type"] == "image/x-exr"
    assert client.get(links["thumbnail"]).content == b"picture 10"
    assert client.get(links["heatmap"]).content == b"map 10"
    assert client.get(links["receipt"]).json() == {"schema_version": 1}


def test_results_answer_ranges_and_conditions(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    runner.let()
    wait_for(job["id"], "done")
    whole = client.get(job["links"]["exr"])
    assert client.get(job["links"]["exr"], headers={"Range": "bytes=3-5"}).content == b"exr"
    assert client.get(job["links"]["exr"], headers={"Range": "bytes=3-5"}).status_code == 206
    again = client.get(job["links"]["exr"], headers={"If-None-Match": whole.headers["etag"]})
    assert again.status_code == 304
    assert not again.content
    head = client.head(job["links"]["exr"])
    assert head.headers["content-length"] == "3000"
    beyond = client.get(job["links"]["exr"], headers={"Range": "bytes=5000-"})
    assert beyond.status_code == 416


def test_the_thumbnail_gets_better_while_the_job_runs(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    runner.let(1)
    wait_for(job["id"], "rendering")
    until(lambda: client.get(job["links"]["thumbnail"]).content == b"picture 1")
    first = client.get(job["links"]["thumbnail"]).headers["etag"]
    runner.let(1)
    until(lambda: client.get(job["links"]["thumbnail"]).content == b"picture 2")
    assert client.get(job["links"]["thumbnail"]).headers["etag"] != first


def test_one_idempotency_key_makes_one_job(client: TestClient, scene: dict[str, Any]) -> None:
    headers = {"Idempotency-Key": "k1"}
    first = client.post("/v1/jobs", json=scene, headers=headers)
    reordered = json.dumps(dict(reversed(scene.items())), indent=3)
    second = client.post(
        "/v1/jobs", content=reordered, headers={**headers, "Content-Type": "application/json"}
    )
    assert second.status_code == 202
    assert second.json()["id"] == first.json()["id"]
    assert second.headers["idempotency-replayed"] == "true"
    third = client.post("/v1/jobs", json={**scene, "name": "another"}, headers=headers)
    assert third.status_code == 409
    assert first.json()["id"] in third.json()["detail"]
    assert len(client.get("/v1/jobs").json()["items"]) == 1


def test_validate_tells_hash_and_makes_no_job(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.post("/v1/validate", json=scene)
    assert answer.status_code == 200
    assert Validation.model_validate_json(answer.content).scene_hash.startswith("sha256:")
    assert client.get("/v1/jobs").json()["items"] == []


def test_the_list_comes_in_pages_newest_first(client: TestClient, scene: dict[str, Any]) -> None:
    made = [client.post("/v1/jobs", json=scene).json()["id"] for _ in range(5)]
    found: list[str] = []
    cursor: str | None = None
    pages = 0
    while True:
        answer = client.get("/v1/jobs", params={"limit": 2, **({"cursor": cursor} if cursor else {})})
        page = JobPage.model_validate_json(answer.content)
        found += [item.id for item in page.items]
        pages += 1
        cursor = page.next
        if cursor is None:
            break
    assert found == made[::-1]
    assert pages == 3


def test_the_list_says_of_each_job_what_its_own_page_does(
    client: TestClient, runner: Any, scene: dict[str, Any], wait_for: Any
) -> None:
    """Lists are written without models: all that their rows may hold must come out as models write it."""
    asked = {"scene": scene, "frames": "1-9", "stop": {"samples": 64, "relative_error": 0.01}}
    several = client.post("/v1/jobs", json=asked).json()["id"]
    runner.let(3)
    done = client.post("/v1/jobs", json={**scene, "name": 'Überraschung "1" \u2028'}).json()["id"]
    runner.let(17)
    wait_for(done, "done")
    runner.fail = True
    runner.let()
    failed = client.post("/v1/jobs", json=scene).json()["id"]
    wait_for(failed, "failed")
    for _ in range(2):
        client.post("/v1/jobs", json=scene)
    answer = client.get("/v1/jobs")
    items = JobPage.model_validate_json(answer.content).items
    assert [item.id for item in items[2:]] == [failed, done, several]
    for item, written in zip(items[1:], answer.json()["items"][1:], strict=True):
        single = client.get(f"/v1/jobs/{item.id}").json()
        assert written == {**single, "curve": []}
        assert item.model_dump(mode="json") == written


def test_the_list_filters_by_state(client: TestClient, scene: dict[str, Any]) -> None:
    ids = [client.post("/v1/jobs", json=scene).json()["id"] for _ in range(3)]
    client.post(f"/v1/jobs/{ids[2]}/cancel")
    cancelled = client.get("/v1/jobs", params={"state": "cancelled"}).json()["items"]
    assert [job["id"] for job in cancelled] == [ids[2]]
    both = client.get("/v1/jobs", params={"state": ["cancelled", "queued"]}).json()["items"]
    assert {job["id"] for job in both} == {ids[1], ids[2]}
    wrong = client.get("/v1/jobs", params={"state": "lost"})
    assert wrong.status_code == 422
    assert "query parameter state" in wrong.json()["errors"][0]["message"]
    assert client.get("/v1/jobs", params={"cursor": "???"}).status_code == 422


def test_a_running_job_can_be_paused_and_resumed(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    runner.let(4)
    until(lambda: client.get(f"/v1/jobs/{job['id']}").json()["progress"] >= 0.4)
    assert client.post(f"/v1/jobs/{job['id']}/pause").json()["state"] == "paused"
    assert client.post(f"/v1/jobs/{job['id']}/pause").json()["state"] == "paused"
    assert client.post(f"/v1/jobs/{job['id']}/resume").json()["state"] == "queued"
    runner.let()
    wait_for(job["id"], "done")
    assert runner.begun_at == [0, 4]
    assert client.post(f"/v1/jobs/{job['id']}/pause").status_code == 409
    assert client.post(f"/v1/jobs/{job['id']}/resume").status_code == 409


@pytest.mark.parametrize("method", ["post", "delete"])
def test_cancel_ends_a_job_and_can_be_repeated(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any, method: str
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    wait_for(job["id"], "rendering")
    path = f"/v1/jobs/{job['id']}" + ("/cancel" if method == "post" else "")
    first = client.request(method, path)
    assert first.json()["state"] == "cancelled"
    assert first.json()["stop_reason"] == "cancelled"
    assert client.request(method, path).json()["state"] == "cancelled"
    following = client.post("/v1/jobs", json=scene).json()
    runner.let()
    wait_for(following["id"], "done")
    assert client.get(f"/v1/jobs/{job['id']}").json()["state"] == "cancelled"
    assert client.post(f"/v1/jobs/{following['id']}/cancel").status_code == 409


def test_higher_priority_goes_first_and_overtakes(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    first = client.post("/v1/jobs", json={"scene": scene}).json()["id"]
    wait_for(first, "rendering")
    runner.let(3)
    second = client.post("/v1/jobs", json={"scene": scene}).json()["id"]
    third = client.post("/v1/jobs", json={"scene": scene}).json()["id"]
    until(lambda: client.get(f"/v1/jobs/{first}").json()["progress"] >= 0.3)
    changed = client.patch(f"/v1/jobs/{third}", json={"priority": 5})
    assert changed.json()["priority"] == 5
    wait_for(third, "rendering")
    assert client.get(f"/v1/jobs/{first}").json()["state"] == "queued"
    runner.let(27)
    for job_id in (first, second, third):
        wait_for(job_id, "done")
    assert runner.ran == [first, third, first, second]
    assert client.patch(f"/v1/jobs/{first}", json={"priority": 1}).status_code == 409


def test_a_failed_job_tells_why_and_the_service_goes_on(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    runner.fail = True
    runner.let()
    status = wait_for(client.post("/v1/jobs", json=scene).json()["id"], "failed")
    assert status["stop_reason"] == "failed"
    assert status["problem"]["title"] == "The kernel does not build"
    runner.fail = False
    runner.let()
    wait_for(client.post("/v1/jobs", json=scene).json()["id"], "done")


def test_a_mistake_of_the_runner_fails_the_job_only(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, until: Any
) -> None:
    runner.raise_error = True
    status = wait_for(client.post("/v1/jobs", json=scene).json()["id"], "failed")
    assert status["problem"]["status"] == 500
    assert "a mistake" not in json.dumps(status)
    runner.raise_error = False
    runner.let()
    wait_for(client.post("/v1/jobs", json=scene).json()["id"], "done")


def test_jobs_go_on_after_a_restart(settings: Any, scene: dict[str, Any], runner: Any, until: Any) -> None:
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        running = client.post("/v1/jobs", json=scene).json()["id"]
        waiting = client.post("/v1/jobs", json=scene).json()["id"]
        runner.let(6)
        until(lambda: client.get(f"/v1/jobs/{running}").json()["progress"] >= 0.6)
    assert runner.stopped
    runner.let(14)
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        until(lambda: client.get(f"/v1/jobs/{waiting}").json()["state"] == "done")
        assert client.get(f"/v1/jobs/{running}").json()["state"] == "done"
    assert runner.ran == [running, running, waiting]
    assert runner.begun_at == [0, 6, 0]


@pytest.mark.usefixtures("alone")
def test_a_killed_service_leaves_no_job_behind(
    settings: Any, scene: dict[str, Any], runner: Any, until: Any
) -> None:
    """The ledger says 'rendering', but no process renders: as after a power cut."""
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        job_id = client.post("/v1/jobs", json=scene).json()["id"]
        until(lambda: client.get(f"/v1/jobs/{job_id}").json()["state"] == "rendering")
    app = create_app(settings, runner)
    app.state.service.jobs.move(job_id, ("queued",), "finishing")
    runner.let()
    with TestClient(app, base_url="http://127.0.0.1") as client:
        until(lambda: client.get(f"/v1/jobs/{job_id}").json()["state"] == "done")


def test_the_queue_outlives_a_ledger_that_fails_for_a_while(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with a full disk: the job's end cannot be written, nor that it failed."""
    monkeypatch.setattr(job_queue, "RETRY_SECONDS", 0.01)
    store = client.app.state.service.jobs  # type: ignore[attr-defined]
    move, refused = store.move, []

    def sometimes(job_id: str, allowed: Any, to: str, **fields: Any) -> Any:
        if to in ("done", "failed") and len(refused) < 2:
            refused.append(to)
            raise OSError("no space left on device")
        return move(job_id, allowed, to, **fields)

    monkeypatch.setattr(store, "move", sometimes)
    runner.let()
    wait_for(client.post("/v1/jobs", json=scene).json()["id"], "done")
    assert refused == ["done", "failed"]


@pytest.mark.usefixtures("alone")
def test_a_restart_sweeps_up_what_no_job_needs(
    settings: Any, scene: dict[str, Any], runner: Any, until: Any
) -> None:
    for name in ("work/left", "assets/ab"):
        (settings.data / name).mkdir(parents=True)
    (settings.data / "work" / "left" / "1.tile").write_bytes(b"old")
    (settings.data / "assets" / ".upload-1").write_bytes(b"half")
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        job_id = client.post("/v1/jobs", json=scene).json()["id"]
        runner.let(3)
        until(lambda: client.get(f"/v1/jobs/{job_id}").json()["progress"] >= 0.3)
        assert not (settings.data / "work" / "left").exists()
        assert not (settings.data / "assets" / ".upload-1").exists()
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1"):
        assert (settings.data / "work" / job_id / "snapshot").is_file()


def test_a_job_that_the_service_failed_leaves_no_snapshots(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any, settings: Any, until: Any
) -> None:
    runner.raise_error = True
    job_id = client.post("/v1/jobs", json=scene).json()["id"]
    wait_for(job_id, "failed")
    until(lambda: not (settings.data / "work" / job_id).exists())


def test_a_job_may_be_longer_as_it_is_kept_than_as_it_came(
    client: TestClient,
    scene: dict[str, Any],
    runner: Any,
    wait_for: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The limit on bodies is for what comes in: 1e9 is kept as 1000000000.0. Any other limit would be 10 bytes here."""
    text = json.dumps(scene).replace('"radiance": 1', '"radiance": 1e9')
    monkeypatch.setattr(parse_json, "__defaults__", (10,))
    runner.let()
    job = client.post("/v1/jobs", content=text, headers={"Content-Type": "application/json"}).json()
    assert wait_for(job["id"], "done")["stop_reason"] == "samples"
    assert (
        client.get(f"/v1/jobs/{job['id']}/scene.json").json()["shapes"][0]["emission"]["radiance"][0] == 1e9
    )
