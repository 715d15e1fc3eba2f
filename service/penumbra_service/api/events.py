"""Streams of server-sent events. An event's id is the job's revision, so a client that reconnects misses
nothing."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Request, Response
from penumbra_scene.job import JobState
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from penumbra_service.api.jobs import service_of
from penumbra_service.service import RenderService
from penumbra_service.status import progress_event
from penumbra_service.store.jobs import JobRow, NoSuchJobError
from penumbra_service.watchers import Watch

router = APIRouter(prefix="/v1", tags=["events"])
RETRY_MILLISECONDS = 2000
SHARED_SECONDS = 1.0


@router.get("/jobs/{job_id}/events", response_class=EventSourceResponse)
async def job_events(
    request: Request, job_id: str, last_event_id: Annotated[str | None, Header()] = None
) -> Response:
    """Progress of one job, as events named `progress`; the stream ends with the job.

    Each event holds the whole of `ProgressEvent`. A client that has seen the end gets 204 and stops.
    """
    service = service_of(request)
    row = await run_in_threadpool(service.jobs.get, job_id)
    seen = int(last_event_id) if last_event_id is not None and last_event_id.isdigit() else 0
    if JobState(row.state).ended and row.revision <= seen:
        return Response(status_code=204)
    return _stream(service, _of_job(service, job_id, seen))


@router.get("/events", response_class=EventSourceResponse)
async def all_events(request: Request) -> Response:
    """Progress of all jobs from now on, in one stream."""
    service = service_of(request)
    return _stream(service, _of_all(service))


def _stream(service: RenderService, events: AsyncIterator[ServerSentEvent]) -> Response:
    return EventSourceResponse(
        events,
        ping=max(1, round(service.settings.heartbeat_seconds)),
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _of_job(service: RenderService, job_id: str, seen: int) -> AsyncIterator[ServerSentEvent]:
    with service.watchers.watch(job_id) as watch:
        while True:
            row = await run_in_threadpool(service.jobs.get, job_id)
            if row.revision > seen:
                seen = row.revision
                yield _event(row)
            if JobState(row.state).ended:
                return
            await watch.changed(_patience(service))


def _patience(service: RenderService) -> float:
    """Seconds until a row is read again unasked: nobody rings for what another service does to a job."""
    return SHARED_SECONDS if service.settings.shared else service.settings.heartbeat_seconds


async def _of_all(service: RenderService) -> AsyncIterator[ServerSentEvent]:
    with service.watchers.watch() as watch:
        while True:
            for row in await _changed_rows(service, watch):
                yield _event(row)


async def _changed_rows(service: RenderService, watch: Watch) -> list[JobRow]:
    rows = []
    for job_id in sorted(await watch.changed(service.settings.heartbeat_seconds)):
        try:
            rows.append(await run_in_threadpool(service.jobs.get, job_id))
        except NoSuchJobError:
            continue
    return rows


def _event(row: JobRow) -> ServerSentEvent:
    return ServerSentEvent(
        data=progress_event(row).model_dump_json(),
        event="progress",
        id=str(row.revision),
        retry=RETRY_MILLISECONDS,
    )
