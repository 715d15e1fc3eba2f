"""Quotes over HTTP, with a runner that renders nothing."""

from __future__ import annotations

import json
from typing import Any

import pytest
from fastapi.testclient import TestClient
from jsonschema import Draft202012Validator
from penumbra_scene.quote import Quote
from penumbra_scene.schema import published
from penumbra_service import service as service_module
from penumbra_service.api.openapi import QUOTE_ANSWER


def test_a_quote_tells_what_errors_cost(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.post("/v1/quotes", json=scene)
    assert answer.status_code == 200
    quote = Quote.model_validate_json(answer.content)
    assert quote.name == "a quad"
    assert quote.table[0].relative_error == 0.05
    Draft202012Validator(published("quote")).validate(answer.json())
    assert client.get("/v1/jobs").json()["items"] == []


def test_a_quote_leaves_no_files(client: TestClient, scene: dict[str, Any], settings: Any) -> None:
    client.post("/v1/quotes", json={"scene": scene, "film": {"width": 8, "height": 8}})
    assert list(settings.work_folder.iterdir()) == []


def test_what_is_wrong_with_the_scene_is_told_with_its_place(
    client: TestClient, scene: dict[str, Any]
) -> None:
    scene["shapes"][0]["type"] = "cube"
    answer = client.post("/v1/quotes", json={"scene": scene})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"].startswith("/scene/shapes/0")


def test_a_quote_that_cannot_be_made_is_a_problem(
    client: TestClient, scene: dict[str, Any], runner: Any
) -> None:
    runner.fail = True
    answer = client.post("/v1/quotes", json=scene)
    assert answer.status_code == 503
    assert answer.headers["content-type"] == "application/problem+json"


def test_quotes_wait_for_each_other_but_not_for_ever(
    client: TestClient, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service_module, "QUOTE_WAIT_SECONDS", 0.01)
    with client.app.state.service._quoting:  # type: ignore[attr-defined]
        answer = client.post("/v1/quotes", json=scene)
    assert answer.status_code == 503
    assert "ask again" in answer.json()["detail"]
    assert client.post("/v1/quotes", json=scene).status_code == 200


def test_openapi_shows_a_quote_as_it_is(client: TestClient) -> None:
    operation = client.get("/openapi.json").json()["paths"]["/v1/quotes"]["post"]
    example = operation["responses"]["200"]["content"]["application/json"]["example"]
    assert example == json.loads(json.dumps(QUOTE_ANSWER["content"]["application/json"]["example"]))
    assert Quote.model_validate(example).end.reason == "relative_error"
    assert "requestBody" in operation
