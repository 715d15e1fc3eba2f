"""The service about itself: devices, schemas, health, metrics, OpenAPI, and what it does not import."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import jsonschema
import pytest
from fastapi.testclient import TestClient
from penumbra_scene.job import DevicePage, DeviceState, DeviceStatus, Health
from penumbra_scene.parse import parse_job, parse_scene
from penumbra_service.api.openapi import EXAMPLE_SCENE
from prometheus_client.parser import text_string_to_metric_families


def test_the_http_process_never_imports_pyopencl() -> None:
    code = (
        "import sys, penumbra_service.app, penumbra_service.serve, penumbra_service.local_runner, "
        "penumbra_service.serving; sys.exit('pyopencl' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_devices_and_workers_are_told(client: TestClient) -> None:
    page = DevicePage.model_validate_json(client.get("/v1/devices").content)
    assert [device.id for device in page.items] == ["fake-0"]
    workers = client.get("/v1/workers").json()["items"]
    assert [worker["devices"] for worker in workers] == [["fake-0"]]


def test_health_tells_ready_degraded_and_why(client: TestClient, runner: Any) -> None:
    health = Health.model_validate_json(client.get("/health").content)
    assert (health.status, health.devices) == ("ok", {"idle": 1})
    assert client.get("/health/ready").status_code == 200
    lost = DeviceStatus(id="fake-0", name="Fake", platform="None", state=DeviceState.LOST)
    runner.devices = lambda: [lost]
    assert client.get("/health").json()["status"] == "degraded"
    assert client.get("/health/ready").status_code == 503
    runner.devices = list
    runner.problem = "this machine has no OpenCL device"
    assert client.get("/health").json()["detail"] == [runner.problem]
    assert client.get("/health/live").status_code == 200


def test_metrics_can_be_scraped(
    client: TestClient, scene: dict[str, Any], runner: Any, wait_for: Any
) -> None:
    runner.let()
    wait_for(client.post("/v1/jobs", json=scene).json()["id"], "done")
    client.get("/nowhere/1")
    client.get("/nowhere/2")
    samples = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(client.get("/metrics").text)
        for sample in family.samples
    }
    assert samples["penumbra_jobs", "done"] == 1
    assert samples["penumbra_jobs", "queued"] == 0
    assert samples["penumbra_devices", "idle"] == 1
    assert samples["penumbra_http_requests_total", "/v1/jobs", "202", "POST"] == 1
    assert samples["penumbra_http_requests_total", "404", "GET", "none"] == 2


def test_schemas_are_published_and_accept_the_example(client: TestClient) -> None:
    assert client.get("/v1/schema").json() == {
        n: f"/v1/schema/{n}" for n in ("scene", "job", "receipt", "quote")
    }
    page = client.get("/docs").text
    assert all(f'href="/v1/schema/{name}"' in page for name in ("scene", "job", "receipt", "quote"))
    schema = client.get("/v1/schema/scene").json()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(EXAMPLE_SCENE, schema)
    jsonschema.validate({"scene": EXAMPLE_SCENE}, client.get("/v1/schema/job.json").json())


def test_every_example_of_openapi_can_be_submitted(client: TestClient) -> None:
    document = client.get("/openapi.json").json()
    body = document["paths"]["/v1/jobs"]["post"]["requestBody"]["content"]["application/json"]
    for example in body["examples"].values():
        assert client.post("/v1/jobs", json=example["value"]).status_code == 202


def test_openapi_is_whole(client: TestClient) -> None:
    """Every reference leads somewhere, every route says what it does, and the contract's models are in it."""
    document = client.get("/openapi.json").json()
    schemas = document["components"]["schemas"]
    references = set(re.findall(r'"#/components/schemas/([^"]+)"', client.get("/openapi.json").text))
    assert references <= schemas.keys()
    assert {"Scene", "JobRequest", "JobStatus", "Problem"} <= schemas.keys()
    for path, methods in document["paths"].items():
        for method, route in methods.items():
            assert route.get("description"), f"{method} {path}"


def test_the_reference_page_needs_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/docs")
    assert page.status_code == 200
    for path in client.get("/openapi.json").json()["paths"]:
        assert path in page.text
    assert not re.search(r'(src|href)="(https?:)?//', page.text)


def test_the_example_is_a_job_and_a_scene() -> None:
    import json

    text = json.dumps(EXAMPLE_SCENE).encode()
    assert parse_scene(text).name == parse_job(b'{"scene": ' + text + b"}").scene.name


@pytest.mark.parametrize(
    "path", ["/v1/jobs/", "/v1//jobs", "/v1/jobs/%2e%2e/jobs", "/v1/jobs/..%2f..%2fetc/result.exr"]
)
def test_odd_paths_lead_nowhere(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404
