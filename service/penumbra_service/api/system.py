"""Routes of the service itself: devices, workers, schemas, health, metrics."""

from __future__ import annotations

import platform
from collections import Counter
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from penumbra_scene.job import DevicePage, DeviceState, Health
from penumbra_scene.schema import PUBLISHED, published
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import BaseModel

from penumbra_service.api.jobs import service_of
from penumbra_service.api.problems import refuse
from penumbra_service.service import RenderService

router = APIRouter(tags=["service"])
VERSION: Final = version("penumbra-render")


class WorkerStatus(BaseModel):
    """A machine that renders."""

    id: str
    host: str
    kind: str
    """local: processes of this service."""
    devices: tuple[str, ...]
    """Ids of its devices."""


class WorkerPage(BaseModel):
    """All workers."""

    items: tuple[WorkerStatus, ...]


@router.get("/v1/devices")
@router.head("/v1/devices", include_in_schema=False)
def devices(request: Request) -> DevicePage:
    """The OpenCL devices that render."""
    return DevicePage(items=tuple(service_of(request).runner.devices()))


@router.get("/v1/workers")
@router.head("/v1/workers", include_in_schema=False)
def workers(request: Request) -> WorkerPage:
    """The machines that render: one, until there is a farm."""
    found = service_of(request).runner.devices()
    local = WorkerStatus(id="local", host=platform.node(), kind="local", devices=tuple(d.id for d in found))
    return WorkerPage(items=(local,))


@router.get("/v1/schema")
def schemas() -> dict[str, str]:
    """Where the JSON Schemas of scenes, jobs, receipts and quotes are."""
    return {name: f"/v1/schema/{name}" for name in PUBLISHED}


@router.get("/v1/schema/{name}")
def schema(name: str) -> JSONResponse:
    """JSON Schema (2020-12) of `scene`, `job`, `receipt` or `quote`."""
    name = name.removesuffix(".json").removesuffix(".schema")
    if name not in PUBLISHED:
        raise refuse(404, f"there is no schema {name!r}; there are: {', '.join(PUBLISHED)}")
    return JSONResponse(published(name), media_type="application/schema+json")


@router.get("/health")
@router.head("/health", include_in_schema=False)
def health(request: Request) -> Health:
    """Whether the service is well, in words. Callers who should have shown a key learn no more than that."""
    found = _health(service_of(request))
    if getattr(request.state, "stranger", False):
        return found.model_copy(update={"jobs": {}, "devices": {}, "detail": ()})
    return found


@router.get("/health/live")
def live() -> dict[str, str]:
    """200 as long as the process answers."""
    return {"status": "ok"}


@router.get("/health/ready", responses={503: {"description": "No device is ready"}})
def ready(request: Request) -> dict[str, Any]:
    """200 once a device is ready to render."""
    if not any(d.state in (DeviceState.IDLE, DeviceState.BUSY) for d in service_of(request).runner.devices()):
        raise refuse(503, "no OpenCL device is ready yet; /v1/devices tells how they stand")
    return {"status": "ok"}


def _health(service: RenderService) -> Health:
    states = Counter(device.state.value for device in service.runner.devices())
    detail = []
    problem = service.runner.problem
    if problem is not None:
        detail.append(problem)
    elif states and not any(states[s] for s in (DeviceState.IDLE, DeviceState.BUSY, DeviceState.STARTING)):
        detail.append("every OpenCL device is lost, so jobs fail")
    return Health(
        status="degraded" if detail else "ok",
        version=VERSION,
        uptime_seconds=(datetime.now(UTC) - service.started).total_seconds(),
        jobs=service.jobs.counts(),
        devices=dict(states),
        detail=tuple(detail),
    )


@router.get("/metrics", response_class=Response)
def metrics(request: Request) -> Response:
    """Prometheus metrics."""
    return Response(generate_latest(request.app.state.metrics.registry), media_type=CONTENT_TYPE_LATEST)
