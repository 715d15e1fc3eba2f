"""Who may ask: keys, names of the service, other sites' pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_service.app import PublicWithoutKeyError, create_app
from penumbra_service.serve import create_key, list_keys, revoke_key
from penumbra_service.settings import Settings, is_loopback

LOCAL = "http://127.0.0.1:8484"


def test_a_public_bind_without_a_key_is_refused(tmp_path: Path, runner: Any) -> None:
    with pytest.raises(PublicWithoutKeyError, match="API key") as refused:
        create_app(Settings(host="0.0.0.0", data=tmp_path), runner)
    assert f"`penumbra keys create NAME --data {tmp_path}`" in str(refused.value)  # as it is to be typed


def test_a_public_bind_with_a_revoked_key_only_is_refused(tmp_path: Path, runner: Any) -> None:
    create_key("old", tmp_path)
    revoke_key("old", tmp_path)
    with pytest.raises(PublicWithoutKeyError):
        create_app(Settings(host="::", data=tmp_path), runner)


def test_a_public_service_wants_its_key(tmp_path: Path, runner: Any, scene: dict[str, Any]) -> None:
    token, _ = create_key("laptop", tmp_path)
    app = create_app(Settings(host="0.0.0.0", data=tmp_path), runner)
    with TestClient(app, base_url="http://render.example") as client:
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": token}):
            answer = client.post("/v1/jobs", json=scene, headers=headers)
            assert answer.status_code == 401
            assert answer.headers["www-authenticate"] == "Bearer"
            assert answer.headers["content-type"] == "application/problem+json"
        assert client.get("/metrics").status_code == 401
        assert client.get("/openapi.json").status_code == 401
        assert client.get("/health/live").status_code == 200
        headers = {"Authorization": f"Bearer {token}"}
        assert client.post("/v1/jobs", json=scene, headers=headers).status_code == 202
        assert client.get("/v1/jobs", headers=headers).status_code == 200


def test_keys_guard_loopback_too_and_revoking_does_not_open_it(tmp_path: Path, runner: Any) -> None:
    token, key = create_key("one", tmp_path)
    app = create_app(Settings(data=tmp_path), runner)
    with TestClient(app, base_url=LOCAL) as client:
        headers = {"Authorization": f"Bearer {token}"}
        assert client.get("/v1/jobs").status_code == 401
        assert client.get("/v1/jobs", headers=headers).status_code == 200
        assert client.get("/v1/jobs", headers={"Cookie": f"penumbra_key={token}"}).status_code == 200
        app.state.service.keys.revoke(key.id)
        assert client.get("/v1/jobs", headers=headers).status_code == 401


def test_strangers_learn_only_that_the_service_is_well(
    tmp_path: Path, runner: Any, scene: dict[str, Any]
) -> None:
    token, _ = create_key("one", tmp_path)
    runner.problem = "no device in /opt/secret"
    headers = {"Authorization": f"Bearer {token}"}
    with TestClient(create_app(Settings(data=tmp_path), runner), base_url=LOCAL) as client:
        client.post("/v1/jobs", json=scene, headers=headers)
        told = client.get("/health").json()
        assert (told["status"], told["jobs"], told["devices"], told["detail"]) == ("degraded", {}, {}, [])
        assert client.get("/health", headers=headers).json()["detail"] == [runner.problem]
        assert sum(client.get("/health", headers=headers).json()["jobs"].values()) == 1


def test_keys_are_stored_as_hashes_only(tmp_path: Path) -> None:
    token, key = create_key("one", tmp_path)
    assert len(token) > 40
    assert [k.name for k in list_keys(tmp_path)] == ["one"]
    assert key.hint == token[: len(key.hint)]
    for file in tmp_path.iterdir():
        assert token.encode() not in file.read_bytes()


def test_idempotency_keys_belong_to_their_callers(tmp_path: Path, runner: Any, scene: dict[str, Any]) -> None:
    tokens = [create_key(name, tmp_path)[0] for name in ("a", "b")]
    with TestClient(create_app(Settings(data=tmp_path), runner), base_url=LOCAL) as client:
        ids = {
            client.post(
                "/v1/jobs", json=scene, headers={"Authorization": f"Bearer {t}", "Idempotency-Key": "same"}
            ).json()["id"]
            for t in tokens
        }
    assert len(ids) == 2


def test_a_name_that_was_made_to_point_here_gets_nothing(client: TestClient) -> None:
    for host in ("evil.example", "evil.example:8484", "127.0.0.1.evil.example", ""):
        assert client.get("/v1/jobs", headers={"Host": host}).status_code == 403
    for host in ("localhost:8484", "127.0.0.1", "[::1]:8484", "LOCALHOST"):
        assert client.get("/v1/jobs", headers={"Host": host}).status_code == 200


def test_further_names_can_be_allowed(tmp_path: Path, runner: Any) -> None:
    app = create_app(Settings(data=tmp_path, hosts=("render.example",)), runner)
    with TestClient(app, base_url=LOCAL) as client:
        assert client.get("/v1/jobs", headers={"Host": "render.example:80"}).status_code == 200
        assert client.get("/v1/jobs", headers={"Host": "other.example"}).status_code == 403


def test_pages_of_other_sites_change_nothing(client: TestClient, scene: dict[str, Any]) -> None:
    job = client.post("/v1/jobs", json=scene, headers={"Origin": LOCAL}).json()["id"]
    for origin in ("http://evil.example", "null", "http://127.0.0.1:9999"):
        assert client.post(f"/v1/jobs/{job}/cancel", headers={"Origin": origin}).status_code == 403
    assert client.get(f"/v1/jobs/{job}", headers={"Origin": "http://evil.example"}).status_code == 200


@pytest.mark.parametrize(
    ("host", "local"),
    [
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("::1", True),
        ("[::1]", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("", False),
        ("10.0.0.1", False),
        ("example.org", False),
        ("localhost.example.org", False),
    ],
)
def test_loopback_is_told_from_public(host: str, local: bool) -> None:
    assert is_loopback(host) is local


def test_an_initial_key_opens_a_public_service_and_can_be_revoked(tmp_path, runner):  # type: ignore[no-untyped-def]
    key = "pnb_" + "k" * 40
    settings = Settings(host="0.0.0.0", data=tmp_path, initial_key=key)
    headers = {"Authorization": f"Bearer {key}"}
    for expected in (200, 401):
        app = create_app(settings, runner)
        with TestClient(app, base_url=LOCAL) as client:
            assert client.get("/v1/jobs").status_code == 401
            assert client.get("/v1/jobs", headers=headers).status_code == expected
            app.state.service.keys.revoke("initial")
            app.state.service.keys.create(f"other-{expected}")
