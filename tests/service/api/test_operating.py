"""Operating a service: limits, quotas, metrics, several jobs at once, several services on one database."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_scene.job import JobState, StopReason
from penumbra_service import job_queue
from penumbra_service.app import create_app
from penumbra_service.running import Outcome, Task
from penumbra_service.service import RenderService
from penumbra_service.settings import Settings
from sqlalchemy.exc import OperationalError


def test_a_full_queue_refuses_with_its_limit(
    settings: Settings, runner: Any, scene: dict[str, Any], until: Any
) -> None:
    app = create_app(replace(settings, max_queued_jobs=2), runner)
    with TestClient(app, base_url="http://127.0.0.1") as client:
        first = client.post("/v1/jobs", json=scene, headers={"Idempotency-Key": "a"}).json()["id"]
        until(lambda: client.get(f"/v1/jobs/{first}").json()["state"] == "rendering")
        assert [client.post("/v1/jobs", json=scene).status_code for _ in range(2)] == [202, 202]
        refused = client.post("/v1/jobs", json=scene)
        assert refused.status_code == 429
        assert refused.json()["type"].endswith(":queue-full")
        assert "2 jobs wait" in refused.json()["detail"]
        assert int(refused.headers["retry-after"]) > 0
        again = client.post("/v1/jobs", json=scene, headers={"Idempotency-Key": "a"})
        assert (again.status_code, again.json()["id"]) == (202, first)


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/validate", "/v1/quotes"])
def test_a_job_beyond_the_operators_limits_is_refused_at_its_place(
    settings: Settings, runner: Any, scene: dict[str, Any], path: str
) -> None:
    """64 samples of 8 x 6 pixels and 10 frames are 30,720."""
    film = {"width": 8, "height": 6}
    limited = replace(settings, max_job_samples=30_719, max_picture_seconds=60.0)
    asked = {"scene": {**scene, "film": film, "stop": {"samples": 64}}, "frames": "1-10"}
    with TestClient(create_app(limited, runner), base_url="http://127.0.0.1") as client:
        refused = client.post(path, json=asked)
        assert refused.status_code == 422
        (error,) = refused.json()["errors"]
        assert (error["pointer"], error["given"]) == (
            "/scene/stop/samples",
            "30720 over all pixels and frames",
        )
        assert "30719" in error["accepted"]
        asked["stop"] = {"samples": 64, "seconds": 60.5}
        pointers = [e["pointer"] for e in client.post(path, json=asked).json()["errors"]]
        assert pointers == ["/stop/samples", "/stop/seconds"]
        bare = client.post(path, json={**scene, "stop": {"seconds": 61}})
        assert [e["pointer"] for e in bare.json()["errors"]] == ["/stop/seconds"]
        asked["stop"] = {"samples": 61}
        assert client.post(path, json=asked).status_code == 422, "61 samples are 64 in whole replicates"
        asked["stop"] = {"samples": 60, "seconds": 60}
        assert client.post(path, json=asked).status_code < 300
        asked["adaptive"] = {"pilot_samples": 8}
        (error,) = client.post(path, json=asked).json()["errors"]
        assert error["given"] == "32640 over all pixels and frames", (
            "a certified pilot is rendered beside the picture"
        )


def test_an_error_ends_at_the_operators_time_and_planned_samples_are_left_alone(
    settings: Settings, runner: Any, scene: dict[str, Any], until: Any
) -> None:
    limited = replace(settings, max_picture_seconds=60.0)
    ran: list[Task] = []
    run = runner.run
    runner.run = lambda task: (ran.append(task), run(task))[1]
    with TestClient(create_app(limited, runner), base_url="http://127.0.0.1") as client:
        for stop, ends in (
            ({"relative_error": 0.01}, 60.0), ({"relative_error": 0.01, "seconds": 5}, 5.0), ({"samples": 7}, None),
        ):  # fmt: skip
            job = client.post("/v1/jobs", json={**scene, "stop": stop}).json()["id"]
            kept = client.get(f"/v1/jobs/{job}/scene.json").json()["stop"]
            assert kept["seconds"] == ends
            until(lambda job=job: ran and ran[-1].job_id == job)
            client.post(f"/v1/jobs/{job}/cancel")
    stops = [task.request.resolved_scene().stop for task in ran]
    assert [s.seconds for s in stops] == [60.0, 5.0, None]
    assert stops[0].relative_error == 0.01


def test_a_used_up_quota_refuses_new_jobs_and_says_what_was_used(
    settings: Settings, scene: dict[str, Any], until: Any
) -> None:
    runner = Spender()
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        service: RenderService = client.app.state.service  # type: ignore[attr-defined]
        token, key = service.keys.create("render-bot", quota_seconds=25.0)
        headers = {"Authorization": f"Bearer {token}"}
        for used in (10.0, 20.0, 30.0):  # a picture that is there when the quota is used up is kept
            job = client.post("/v1/jobs", json=scene, headers=headers)
            assert job.status_code == 202
            path = f"/v1/jobs/{job.json()['id']}"
            until(lambda path=path: client.get(path, headers=headers).json()["state"] == "done")
            assert service.keys.get(key.id).used_seconds == used  # type: ignore[union-attr]
        refused = client.post("/v1/jobs", json=scene, headers=headers)
        assert refused.status_code == 403
        assert refused.json()["type"].endswith(":quota-used")
        assert "'render-bot' has a quota of 25 device-seconds and has used 30.0" in refused.json()["detail"]
        service.keys.set_quota("render-bot", 100.0)
        assert client.post("/v1/jobs", json=scene, headers=headers).status_code == 202


def test_a_job_that_uses_up_its_keys_quota_is_paused_and_goes_on_once_there_is_more(
    settings: Settings, scene: dict[str, Any], until: Any
) -> None:
    runner = Waiting()
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        service: RenderService = client.app.state.service  # type: ignore[attr-defined]
        token, _ = service.keys.create("render-bot", quota_seconds=12.0)
        client.headers["Authorization"] = f"Bearer {token}"

        def stands(job: str, state: str, reason: str | None) -> bool:
            status = client.get(f"/v1/jobs/{job}").json()
            return (status["state"], status["stop_reason"]) == (state, reason)

        first, second = (client.post("/v1/jobs", json=scene).json()["id"] for _ in range(2))
        until(lambda: first in runner.held)
        assert stands(first, "rendering", None)
        runner.held[first].report(JobState.RENDERING, {"device_seconds": 12.5})
        until(lambda: stands(first, "paused", "quota") and stands(second, "paused", "quota"))
        until(lambda: first not in runner.held)
        assert runner.begun == [first]  # the other one came up with nothing left
        assert service.work_folder(first).is_dir()  # where its snapshot lies
        refused = client.post(f"/v1/jobs/{first}/resume")
        assert (refused.status_code, refused.json()["type"][-11:]) == (403, ":quota-used")
        assert stands(first, "paused", "quota")
        assert "its key has used up its device-seconds" in client.get(f"/jobs/{first}").text
        service.keys.set_quota("render-bot", 100.0)
        assert client.post(f"/v1/jobs/{first}/resume").json()["stop_reason"] is None
        runner.free |= {first}
        until(lambda: stands(first, "done", "samples"))


class Spender:
    """Renders nothing, and uses ten device-seconds for it, told in two reports."""

    problem: str | None = None

    def start(self) -> None:
        pass

    def stop(self) -> None:
        pass

    def devices(self) -> list[Any]:
        return []

    def run(self, task: Task) -> Outcome:
        for seconds in (4.0, 10.0):
            task.report(
                JobState.RENDERING,
                {
                    "device_seconds": seconds,
                    "seconds": seconds / 2,
                    "relmse": 0.04,
                    "theta": 1.25,
                    "progress": 0.5,
                },
            )
        return Outcome(StopReason.SAMPLES)


class Waiting(Spender):
    """Holds what it runs until it is let go."""

    def __init__(self) -> None:
        self.held: dict[str, Task] = {}
        self.free: set[str] = set()
        self.begun: list[str] = []

    def run(self, task: Task) -> Outcome:
        self.begun.append(task.job_id)
        super().run(task)
        self.held[task.job_id] = task
        try:
            while task.job_id not in self.free:
                if task.control.reason is not None:
                    return Outcome()
                job_queue.threading.Event().wait(0.01)
        finally:
            del self.held[task.job_id]
        return Outcome(StopReason.SAMPLES)


def test_several_jobs_share_the_devices_and_the_least_urgent_makes_room(
    settings: Settings, scene: dict[str, Any], until: Any
) -> None:
    runner = Waiting()
    app = create_app(replace(settings, jobs_at_once=2), runner)
    with TestClient(app, base_url="http://127.0.0.1") as client:

        def submit(priority: int) -> str:
            return str(client.post("/v1/jobs", json={"scene": scene, "priority": priority}).json()["id"])

        low, middle = submit(1), submit(2)
        until(lambda: runner.held.keys() == {low, middle})
        urgent = submit(3)
        until(lambda: runner.held.keys() == {urgent, middle})
        assert client.get(f"/v1/jobs/{low}").json()["state"] == "queued"
        told: list[int] = []
        runner.held[middle].control.when_prioritized(told.append)
        client.patch(f"/v1/jobs/{middle}", json={"priority": 7})
        until(lambda: told[-1:] == [7])  # it may have been told its first one as well
        runner.free |= {low, middle, urgent}
        for job in (low, middle, urgent):
            until(lambda job=job: client.get(f"/v1/jobs/{job}").json()["state"] == "done")


def test_metrics_tell_of_work_and_error(settings: Settings, scene: dict[str, Any], until: Any) -> None:
    runner = Waiting()
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        job = client.post("/v1/jobs", json={"scene": scene, "frames": "1-4"}).json()["id"]
        until(lambda: job in runner.held)
        text = client.get("/metrics").text
        assert 'penumbra_jobs{state="rendering"} 1.0' in text
        assert "penumbra_device_seconds_total 10.0" in text
        assert f'penumbra_job_relative_error{{job="{job}"}} 0.2' in text
        assert f'penumbra_job_error_fall_per_second{{job="{job}"}} 0.01' in text  # 1.25 * 0.04 / 5
        assert 'penumbra_frames{state="open"} 4.0' in text
        runner.free.add(job)
        until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] == "done")
        until(lambda: "penumbra_job_relative_error{" not in client.get("/metrics").text)


@pytest.fixture
def two(
    postgres_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[list[TestClient], list[Waiting]]]:
    """Two services on one database and one folder."""
    monkeypatch.setattr(job_queue, "BEAT_SECONDS", 0.05)
    monkeypatch.setattr(job_queue, "LOOK_SECONDS", 0.05)
    settings = Settings(data=tmp_path, database_url=postgres_url, shutdown_seconds=5.0)
    runners = [Waiting(), Waiting()]
    with ExitStack() as stack:
        clients = [
            stack.enter_context(TestClient(create_app(settings, runner), base_url="http://127.0.0.1"))
            for runner in runners
        ]
        yield clients, runners


def test_two_services_on_one_database_share_the_queue(
    two: tuple[list[TestClient], list[Waiting]], scene: dict[str, Any], until: Callable[[Any], None]
) -> None:
    clients, runners = two
    ids = [clients[0].post("/v1/jobs", json=scene).json()["id"] for _ in range(6)]
    until(lambda: len(runners[0].held) == len(runners[1].held) == 1)
    held = [next(iter(runner.held)) for runner in runners]
    assert len(set(held)) == 2
    # each may steer what the other holds
    assert clients[0].post(f"/v1/jobs/{held[1]}/pause").json()["state"] == "paused"
    until(lambda: held[1] not in runners[1].held)
    clients[1].post(f"/v1/jobs/{held[0]}/cancel")
    until(lambda: held[0] not in runners[0].held)
    clients[0].post(f"/v1/jobs/{held[1]}/resume")
    for runner in runners:
        runner.free |= set(ids)
    for job in ids:
        wanted = "cancelled" if job == held[0] else "done"
        until(lambda job=job, wanted=wanted: clients[1].get(f"/v1/jobs/{job}").json()["state"] == wanted)


def _one_of_them_renders(
    two: tuple[list[TestClient], list[Waiting]], scene: dict[str, Any], until: Callable[[Any], None]
) -> tuple[list[RenderService], str, int]:
    """Both services, a job, and which of them has it."""
    clients, runners = two
    job = clients[0].post("/v1/jobs", json=scene).json()["id"]
    until(lambda: any(job in runner.held for runner in runners))
    services = [client.app.state.service for client in clients]  # type: ignore[attr-defined]
    return services, job, 0 if job in runners[0].held else 1


def test_a_dead_services_job_is_taken_over_and_the_dead_one_cannot_touch_it(
    two: tuple[list[TestClient], list[Waiting]],
    scene: dict[str, Any],
    until: Callable[[Any], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clients, runners = two
    services, job, dead = _one_of_them_renders(two, scene, until)
    heir = 1 - dead
    monkeypatch.setattr(services[dead].jobs, "beat", lambda *_: 0)  # as if it were stopped
    monkeypatch.setattr(services[dead].queue, "_look", lambda *_: None)
    monkeypatch.setattr(services[dead].queue, "_release", lambda *_: None)
    task = runners[dead].held[job]
    monkeypatch.setattr(job_queue, "DEAD_SECONDS", 0.3)
    until(lambda: job in runners[heir].held)
    task.report(JobState.FINISHING, {"progress": 0.9})  # it wakes up
    runners[dead].free.add(job)
    until(lambda: job not in runners[dead].held)
    status = clients[heir].get(f"/v1/jobs/{job}").json()
    assert (status["state"], status["progress"]) == ("rendering", 0.5)
    runners[heir].free.add(job)
    until(lambda: clients[dead].get(f"/v1/jobs/{job}").json()["state"] == "done")


def test_where_the_ledger_was_away_nobody_is_taken_for_dead(
    two: tuple[list[TestClient], list[Waiting]],
    scene: dict[str, Any],
    until: Callable[[Any], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    services, _, holder = _one_of_them_renders(two, scene, until)
    other = 1 - holder
    monkeypatch.setattr(job_queue, "DEAD_SECONDS", 0.5)
    away, beats, beat = threading.Event(), Counter[int](), services[other].jobs.beat
    away.set()
    monkeypatch.setattr(services[holder].jobs, "beat", lambda *_: 0)  # silent from now on

    def refuse(*words: Any) -> int:
        beats[away.is_set()] += 1
        if away.is_set():
            raise OperationalError("beat", {}, OSError("the server has gone"))
        return beat(*words)

    monkeypatch.setattr(services[other].jobs, "beat", refuse)
    released = []
    release = services[other].jobs.release
    monkeypatch.setattr(
        services[other].jobs, "release", lambda *words: (released.append(beats[False]), release(*words))[1]
    )
    until(lambda: beats[True] >= 20)  # a second, twice what a dead one is given
    assert not released
    away.clear()
    until(lambda: released)
    assert released[0] > 3, "only after it was in touch for as long itself"
