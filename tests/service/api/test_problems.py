"""Every error is problem+json and says where, what was given, what is accepted."""

from __future__ import annotations

import copy
import gzip
import json
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_scene.errors import Problem
from penumbra_service.app import create_app
from penumbra_service.settings import Settings

JSON = {"Content-Type": "application/json"}
MESH: dict[str, Any] = {
    "type": "mesh",
    "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "indices": [[0, 1, 2]],
}


def problem_of(answer: Any, status: int) -> Problem:
    """The problem that an answer must hold."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = Problem.model_validate_json(answer.content)
    assert problem.status == status
    assert problem.detail
    return problem


def put(document: Any, path: str, value: Any) -> Any:
    """The document with another value at a JSON pointer; a function takes what is there."""
    changed = copy.deepcopy(document)
    at = changed
    *parents, last = path.split("/")[1:]
    for key in parents:
        at = at[int(key)] if isinstance(at, list) else at.setdefault(key, {})
    at[int(last) if isinstance(at, list) else last] = value
    return changed


MALFORMED: dict[str, tuple[str, Any]] = {
    "unknown key": ("/camera/fovv", 40),
    "unknown top key": ("/shape", []),
    "wrong version": ("/version", 2),
    "unknown shape": ("/shapes/0/type", "cube"),
    "string for number": ("/camera/fov", "40"),
    "boolean for number": ("/camera/fov", True),
    "negative size": ("/film/width", -1),
    "zero size": ("/film/height", 0),
    "fractional size": ("/film/width", 1.5),
    "huge size": ("/film/width", 10**9),
    "huge integer": ("/film/width", 10**30),
    "too many pixels": ("/film", {"width": 32768, "height": 32768}),
    "fov of a half circle": ("/camera/fov", 180),
    "empty mesh": ("/shapes/0", {"type": "mesh", "positions": [], "indices": []}),
    "mesh without indices": ("/shapes/0", {"type": "mesh", "positions": MESH["positions"]}),
    "index out of range": ("/shapes/0", {**MESH, "indices": [[0, 1, 3]]}),
    "negative index": ("/shapes/0", {**MESH, "indices": [[0, 1, -1]]}),
    "negative radius": ("/shapes/0", {"type": "sphere", "radius": -1}),
    "zero radius": ("/shapes/0", {"type": "sphere", "radius": 0}),
    "negative radiance": ("/shapes/0/emission/radiance", [-1, 0, 0]),
    "two colour channels": ("/shapes/0/emission/radiance", [1, 2]),
    "unknown material": ("/shapes/0/material", "gold"),
    "unknown texture": ("/materials", {"m": {"type": "diffuse", "color": {"texture": "none"}}}),
    "unknown prototype": ("/shapes/0", {"type": "instance", "prototype": "none"}),
    "zero direction": ("/shapes/0", {"type": "disc", "normal": [0, 0, 0]}),
    "parallel quad": ("/shapes/0", {"type": "quad", "u": [1, 0, 0], "v": [2, 0, 0]}),
    "shutter backwards": ("/camera/shutter", {"open": 1, "close": 0}),
    "two blades": ("/camera/lens", {"blades": 2}),
    "unknown sampler": ("/sampler", {"type": "magic"}),
    "three replicates": ("/sampler", {"replicates": 3}),
    "seed of 65 bits": ("/sampler", {"seed": str(2**64)}),
    "no samples": ("/stop", {"samples": 0}),
    "error above one": ("/stop", {"relative_error": 1.5}),
    "target without randomness": ("", {"sampler": {"type": "regular"}, "stop": {"relative_error": 0.1}}),
    "crop outside": ("/film", {"width": 8, "height": 8, "crop": {"x": 4, "y": 0, "width": 8, "height": 8}}),
    "missing asset": ("/shapes/0", {"type": "mesh", "source": {"asset": "sha256:" + "0" * 64}}),
    "asset that is no hash": ("/shapes/0", {"type": "mesh", "source": {"asset": "http://example.org/a.obj"}}),
    "file on the service": ("/shapes/0", {"type": "mesh", "source": {"file": "a.obj"}}),
    "path that leaves": ("/shapes/0", {"type": "mesh", "source": {"file": "../../etc/passwd"}}),
    "missing environment": ("/environment", {"type": "image", "image": {"asset": "sha256:" + "1" * 64}}),
    "array for scene": ("/shapes", {}),
    "null shape": ("/shapes/0", None),
    "beyond float32": ("/shapes/0", {"type": "sphere", "radius": 1e30}),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_scene_is_refused_at_its_place(
    client: TestClient, scene: dict[str, Any], name: str
) -> None:
    path, value = MALFORMED[name]
    wrong = {**scene, **value} if path == "" else put(scene, path, value)
    for sent, base in ((wrong, ""), ({"scene": wrong}, "/scene")):
        problem = problem_of(client.post("/v1/jobs", json=sent), 422)
        assert problem.errors
        for item in problem.errors:
            assert item.pointer.startswith(base)
            assert item.message
            assert item.given
            assert item.accepted
        # the blame falls on the changed place, or beside or around it
        top = "/".join(path.split("/")[:2]) if path else "/stop"
        assert any(item.pointer.startswith(base + top) for item in problem.errors), problem
        problem_of(client.post("/v1/validate", json=sent), 422)
    assert client.get("/v1/jobs").json()["items"] == []


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"nonsense",
        b"\xff\xfe{}",
        b"\xef\xbb\xbf{}",
        b'{"version": NaN}',
        b'{"version": Infinity}',
        b'{"version": 1, "version": 1}',
        b'{"a\\ud800": 1}',
        b"[" * 100_000,
    ],
    ids=["empty", "cut", "words", "utf16", "mark", "nan", "inf", "twice", "surrogate", "deep"],
)
def test_what_is_no_json_is_refused(client: TestClient, body: bytes) -> None:
    for path in ("/v1/jobs", "/v1/validate"):
        assert problem_of(client.post(path, content=body, headers=JSON), 422).errors


@pytest.mark.parametrize("body", [b"null", b"3", b'"x"', b"[]", b"{}", b'{"scene": 3}', b'{"scene": null}'])
def test_json_that_is_no_job_is_refused(client: TestClient, body: bytes) -> None:
    assert problem_of(client.post("/v1/jobs", content=body, headers=JSON), 422).errors


def test_numbers_that_overflow_are_refused(client: TestClient, scene: dict[str, Any]) -> None:
    text = json.dumps(scene).replace('"radiance": 1', '"radiance": 1e999')
    problem = problem_of(client.post("/v1/jobs", content=text, headers=JSON), 422)
    assert problem.errors[0].pointer.startswith("/shapes/0/emission/radiance")


def test_the_body_of_a_form_is_refused_with_advice(client: TestClient) -> None:
    problem = problem_of(client.post("/v1/jobs", data={"a": "b"}), 415)
    assert "Content-Type: application/json" in problem.detail


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/validate", "/v1/quotes", "/v1/assets"])
def test_a_body_that_was_packed_is_refused_as_such(
    client: TestClient, scene: dict[str, Any], path: str
) -> None:
    packed = gzip.compress(json.dumps(scene).encode())
    problem = problem_of(client.post(path, content=packed, headers={**JSON, "Content-Encoding": "gzip"}), 415)
    assert "given Content-Encoding: gzip, accepted: none" in problem.detail
    plain = client.post("/v1/validate", json=scene, headers={"Content-Encoding": "identity"})
    assert plain.status_code == 200


def test_a_body_that_is_too_long_is_refused(settings: Settings, runner: Any, scene: dict[str, Any]) -> None:
    small = Settings(data=settings.data, max_body_bytes=100)
    with TestClient(create_app(small, runner), base_url="http://127.0.0.1") as client:
        assert "100" in problem_of(client.post("/v1/jobs", json=scene), 413).detail

        def pieces() -> Any:
            yield b" " * 60
            yield b" " * 60

        problem_of(client.post("/v1/jobs", content=pieces(), headers=JSON), 413)


def test_what_is_not_there_is_told(client: TestClient) -> None:
    for path in (
        "/v1/jobs/nothing",
        "/v1/jobs/nothing/result.exr",
        "/v1/jobs/x/events",
        "/v1/nothing",
        "/v2",
    ):
        problem_of(client.get(path), 404)
    problem_of(client.get("/v1/assets/" + "0" * 64), 404)
    problem_of(client.get("/v1/assets/" + "0" * 64 + "/content"), 404)
    problem_of(client.post("/v1/jobs/nothing/cancel"), 404)
    problem_of(client.get("/v1/schema/nothing"), 404)


def test_a_wrong_method_is_told_with_the_right_ones(client: TestClient) -> None:
    answer = client.put("/v1/jobs", json={})
    problem = problem_of(answer, 405)
    assert answer.headers["allow"] == "GET, HEAD, POST", "of all routes of the path"
    assert "accepted: GET, HEAD, POST" in problem.detail
    assert client.post("/v1/devices").headers["allow"].startswith("GET")


def test_parameters_are_checked(client: TestClient, scene: dict[str, Any]) -> None:
    for limit in ("0", "x", "1001"):
        problem = problem_of(client.get("/v1/jobs", params={"limit": limit}), 422)
        assert "query parameter limit" in problem.errors[0].message
        assert limit in problem.errors[0].given
    problem_of(client.post("/v1/jobs", json=scene, headers={"Idempotency-Key": "k" * 256}), 422)
    job = client.post("/v1/jobs", json=scene).json()["id"]
    for change in (
        {},
        {"priority": "high"},
        {"priority": 101},
        {"priority": 1, "name": "x"},
        {"priority": 1.5},
    ):
        assert problem_of(client.patch(f"/v1/jobs/{job}", json=change), 422).errors
    problem_of(client.patch(f"/v1/jobs/{job}", content=b"{", headers=JSON), 422)


def test_a_mistake_of_the_service_is_a_problem_without_secrets(settings: Settings, runner: Any) -> None:
    app = create_app(settings, runner)
    with TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False) as client:
        app.state.service.jobs.page = None
        problem = problem_of(client.get("/v1/jobs"), 500)
        assert "NoneType" not in problem.model_dump_json()


def test_a_change_of_a_job_is_told_what_is_accepted(client: TestClient, scene: dict[str, Any]) -> None:
    job = client.post("/v1/jobs", json=scene).json()["id"]
    (unknown, missing) = problem_of(client.patch(f"/v1/jobs/{job}", json={"prio": 5}), 422).errors[::-1]
    assert (missing.pointer, missing.message, missing.given) == ("/priority", "is missing", "nothing")
    assert (unknown.pointer, unknown.accepted) == ("/prio", "the keys priority (did you mean this?)")
    (high,) = problem_of(client.patch(f"/v1/jobs/{job}", json={"priority": 101}), 422).errors
    assert high.accepted == "a whole number at least -100, at most 100"


@pytest.mark.parametrize(
    ("address", "accepted"),
    [
        ("/v1/jobs?limit=0", "a number of at least 1"),
        ("/v1/jobs?limit=x", "a whole number"),
        ("/v1/jobs?state=foo", "'paused'"),
        ("/v1/assets/nope", "[0-9a-f]{64}"),
    ],
)
def test_parameters_are_told_what_is_accepted(client: TestClient, address: str, accepted: str) -> None:
    (item,) = problem_of(client.get(address), 422).errors
    assert accepted in item.accepted
    assert "parameter" in item.message


def test_ranges_are_refused_as_problems(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any
) -> None:
    job = client.post("/v1/jobs", json=scene).json()
    runner.let()
    wait_for(job["id"], "done")
    beyond = client.get(job["links"]["exr"], headers={"Range": "bytes=5000-"})
    assert problem_of(beyond, 416).type.endswith("range-not-satisfiable")
    assert beyond.headers["content-range"] == "bytes */3000"
    problem_of(client.get(job["links"]["exr"], headers={"Range": "lines=1-2"}), 400)


def test_the_api_says_how_it_refuses(client: TestClient) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    assert {"404", "416", "401", "403"} <= paths["/v1/jobs/{job_id}/result.exr"]["get"]["responses"].keys()
    assert {"413", "415", "422"} <= paths["/v1/assets"]["post"]["responses"].keys()
    for operations in paths.values():
        for operation in operations.values():
            for status, answer in operation["responses"].items():
                if status in ("401", "403", "404", "413", "415", "416", "422"):
                    assert "Problem" in str(answer["content"]), (operation["operationId"], status)


def test_head_answers_where_get_does(client: TestClient, scene: dict[str, Any]) -> None:
    job = client.post("/v1/jobs", json=scene).json()["id"]
    for path in (f"/v1/jobs/{job}", "/v1/jobs", "/v1/devices", "/health", "/"):
        answer = client.head(path, follow_redirects=False)
        assert answer.status_code == client.get(path, follow_redirects=False).status_code, path
        assert answer.content == b""
