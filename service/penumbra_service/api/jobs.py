"""Routes of jobs: submit, list, look, cancel, pause, resume, re-prioritise."""

from __future__ import annotations

import base64
from typing import Annotated, Any, Final

from fastapi import APIRouter, Header, Query, Request, Response
from penumbra_scene.check import check_scene, scene_hash
from penumbra_scene.errors import Problem
from penumbra_scene.job import Finding, JobPage, JobState, JobStatus, Validation
from starlette.concurrency import run_in_threadpool

from penumbra_service.api.bodies import parse_change, parse_for_validation, parse_submission, read_json
from penumbra_service.api.openapi import CHANGE_BODY, JOB_BODY
from penumbra_service.api.problems import refuse
from penumbra_service.service import RenderService, new_job
from penumbra_service.status import job_page, job_status
from penumbra_service.store.ids import is_id
from penumbra_service.store.jobs import MAX_PAGE

router = APIRouter(prefix="/v1", tags=["jobs"])

_MAX_KEY: Final = 255
_PROBLEM: Final[dict[str, Any]] = {"model": Problem, "description": "A problem (application/problem+json)"}
_ON_JOB: Final[dict[int | str, dict[str, Any]]] = {404: _PROBLEM, 409: _PROBLEM}
_ON_BODY: Final[dict[int | str, dict[str, Any]]] = dict.fromkeys((400, 409, 413, 415, 422), _PROBLEM)
_ON_NEW: Final[dict[int | str, dict[str, Any]]] = {**_ON_BODY, **dict.fromkeys((403, 429), _PROBLEM)}


def service_of(request: Request) -> RenderService:
    """The service behind this application."""
    service: RenderService = request.app.state.service
    return service


def owner_of(request: Request) -> str | None:
    """The id of the key that was shown, if any."""
    key = getattr(request.state, "api_key", None)
    return None if key is None else str(key.id)


@router.post("/jobs", status_code=202, responses=_ON_NEW, openapi_extra=JOB_BODY)
async def submit(
    request: Request,
    response: Response,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=_MAX_KEY)] = None,
) -> JobStatus:
    """Submit a scene to be rendered.

    The body is a job `{"scene": {...}, "priority": 0, ...}` or just a scene. With an `Idempotency-Key`,
    the same submission sent twice makes one job; another body under the same key is refused (409).
    """
    service = service_of(request)
    limit, settings = service.settings.max_body_bytes, service.settings
    sent = await read_json(request, limit, lambda body: parse_submission(body, settings, service.assets))
    job = new_job(sent.request, sent.text, sent.digest, owner_of(request), idempotency_key)
    row, created = await run_in_threadpool(service.submit, job)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    if not created:
        response.headers["Idempotency-Replayed"] = "true"
    return job_status(row)


@router.post("/validate", responses=_ON_BODY, openapi_extra=JOB_BODY)
async def validate(request: Request) -> Validation:
    """Check what would be submitted, without rendering it: 422 with every error, or the scene's hash and
    warnings."""
    service = service_of(request)
    limit = service.settings.max_body_bytes

    def check(body: bytes) -> Validation:
        scene = parse_for_validation(body, service.settings, service.assets)
        findings = [
            Finding(pointer=found.pointer, message=found.message)
            for found in check_scene(scene)
            if found.warning
        ]
        return Validation(scene_hash=scene_hash(scene), warnings=tuple(findings))

    return await read_json(request, limit, check)


@router.get("/jobs", response_model=JobPage)
@router.head("/jobs", include_in_schema=False)
def list_jobs(
    request: Request,
    state: Annotated[list[JobState] | None, Query(description="only jobs in these states")] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_PAGE)] = 50,
    cursor: Annotated[str | None, Query(description="`next` of the page before")] = None,
) -> Response:
    """The jobs, newest first, a page at a time."""
    rows = service_of(request).jobs.page(state or (), _job_before(cursor), limit + 1)
    following = _cursor(rows[limit - 1].id) if len(rows) > limit else None
    return Response(job_page(rows[:limit], following), media_type="application/json")


def _cursor(job_id: str) -> str:
    return base64.urlsafe_b64encode(job_id.encode()).decode().rstrip("=")


def _job_before(cursor: str | None) -> str | None:
    if cursor is None:
        return None
    try:
        job_id = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode("ascii")
    except ValueError:
        job_id = ""
    if not is_id(job_id):
        raise refuse(422, f"cursor: given {cursor[:80]!r}, accepted: the `next` of an earlier page")
    return job_id


@router.get("/jobs/{job_id}", responses=_ON_JOB)
@router.head("/jobs/{job_id}", include_in_schema=False)
def get_job(request: Request, job_id: str) -> JobStatus:
    """How a job stands."""
    return job_status(service_of(request).jobs.get(job_id), curve=True)


@router.patch("/jobs/{job_id}", responses={**_ON_BODY, **_ON_JOB}, openapi_extra=CHANGE_BODY)
async def change_job(request: Request, job_id: str) -> JobStatus:
    """Re-prioritise a job. A running one makes room for a waiting one of higher priority."""
    service = service_of(request)
    limit = service.settings.max_body_bytes
    change = await read_json(request, limit, lambda body: parse_change(body, limit))
    return job_status(await run_in_threadpool(service.prioritize, job_id, change.priority))


@router.post("/jobs/{job_id}/cancel", responses=_ON_JOB)
def cancel_job(request: Request, job_id: str) -> JobStatus:
    """End a job. What it has shown so far stays."""
    return job_status(service_of(request).cancel(job_id))


@router.delete("/jobs/{job_id}", responses=_ON_JOB)
def delete_job(request: Request, job_id: str) -> JobStatus:
    """The same as cancel."""
    return job_status(service_of(request).cancel(job_id))


@router.post("/jobs/{job_id}/pause", responses=_ON_JOB)
def pause_job(request: Request, job_id: str) -> JobStatus:
    """Stop working on a job, keeping its samples."""
    return job_status(service_of(request).pause(job_id))


@router.post("/jobs/{job_id}/resume", responses={403: _PROBLEM, **_ON_JOB})
def resume_job(request: Request, job_id: str) -> JobStatus:
    """Go on with a paused job where it stopped. One whose key has used up its quota stays paused (403)."""
    return job_status(service_of(request).resume(job_id))
