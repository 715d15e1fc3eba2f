"""Assets over HTTP."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest
from fastapi.testclient import TestClient
from penumbra_scene import limits
from penumbra_scene.job import AssetInfo
from penumbra_service.app import create_app
from penumbra_service.settings import Settings

OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n"
NAME = "sha256:" + hashlib.sha256(OBJ).hexdigest()


def test_an_uploaded_mesh_can_be_used(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.post("/v1/assets", content=OBJ)
    assert answer.status_code == 201
    info = AssetInfo.model_validate_json(answer.content)
    assert info == AssetInfo(
        asset=NAME, bytes=len(OBJ), kind="mesh", format="obj", detail="2 triangles", created=True
    )
    assert answer.headers["location"] == f"/v1/assets/{NAME}"
    scene["shapes"].append({"type": "mesh", "source": {"asset": NAME}})
    assert client.post("/v1/jobs", json=scene).status_code == 202
    image = {**scene, "environment": {"type": "image", "image": {"asset": NAME}}}
    problem = client.post("/v1/jobs", json=image)
    assert problem.status_code == 422
    assert problem.json()["errors"][0]["pointer"] == "/environment/image/asset"
    assert "accepted formats" in problem.json()["errors"][0]["message"]


def test_triangles_of_assets_count_every_time_they_are_used(
    client: TestClient, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    client.post("/v1/assets", content=OBJ)
    mesh = {"type": "mesh", "source": {"asset": NAME}}
    monkeypatch.setattr(limits, "MAX_TRIANGLES", 4)
    scene["shapes"] += [mesh, mesh]
    assert client.post("/v1/validate", json=scene).status_code == 200
    scene["shapes"].append(mesh)
    error = client.post("/v1/validate", json={"scene": scene}).json()["errors"][0]
    assert (error["pointer"], error["given"]) == ("/scene/shapes", "6")
    assert "at most 4" in error["accepted"]


def test_the_same_bytes_are_one_asset(client: TestClient) -> None:
    assert client.head(f"/v1/assets/{NAME}").status_code == 404
    assert client.put(f"/v1/assets/{NAME}", content=OBJ).status_code == 201
    again = client.put(f"/v1/assets/{NAME.removeprefix('sha256:')}", content=OBJ)
    assert again.status_code == 200
    assert again.json()["created"] is False
    assert client.head(f"/v1/assets/{NAME}").status_code == 200
    assert client.get(f"/v1/assets/{NAME}").json()["bytes"] == len(OBJ)
    assert client.get(f"/v1/assets/{NAME}/content").content == OBJ


def test_bytes_with_another_hash_are_refused(client: TestClient) -> None:
    wrong = client.put("/v1/assets/" + "0" * 64, content=OBJ)
    assert wrong.status_code == 422
    assert NAME.removeprefix("sha256:") in wrong.json()["detail"]
    assert client.head(f"/v1/assets/{NAME}").status_code == 404
    assert client.put("/v1/assets/nothing", content=OBJ).status_code == 422


def test_broken_files_are_refused_and_forgotten(client: TestClient, settings: Settings) -> None:
    for data in (b"", b"no mesh", OBJ + b"f 1 2 99\n"):
        answer = client.post("/v1/assets", content=data)
        assert answer.status_code == 422
        assert answer.headers["content-type"] == "application/problem+json"
        assert client.head("/v1/assets/" + hashlib.sha256(data).hexdigest()).status_code == 404
    assert client.post("/v1/assets", files={"file": OBJ}).status_code == 415
    left = [p for p in settings.assets_folder.rglob("*") if p.is_file() and ".decoded" not in p.parts]
    assert left == []


def test_large_files_are_refused(settings: Settings, runner: Any) -> None:
    small = Settings(data=settings.data, max_asset_bytes=45)
    with TestClient(create_app(small, runner), base_url="http://127.0.0.1") as client:

        def pieces() -> Any:
            yield OBJ[:40]
            yield OBJ[40:]

        assert client.post("/v1/assets", content=OBJ).status_code == 413
        assert client.post("/v1/assets", content=pieces()).status_code == 413


def test_the_order_of_checks_tells_the_place_of_every_missing_asset(
    client: TestClient, scene: dict[str, Any]
) -> None:
    missing = {"asset": "sha256:" + "0" * 64}
    scene["shapes"] += [{"type": "mesh", "source": missing}, {"type": "mesh", "source": missing}]
    scene["textures"] = {"a/b": {"type": "image", "image": missing}}
    errors = client.post("/v1/jobs", json={"scene": scene}).json()["errors"]
    assert {error["pointer"] for error in errors} == {
        "/scene/shapes/1/source/asset",
        "/scene/shapes/2/source/asset",
        "/scene/textures/a~1b/image/asset",
    }
