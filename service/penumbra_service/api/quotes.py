"""The route of quotes: what accuracy would cost, before the work."""

from __future__ import annotations

from typing import Any, Final

from fastapi import APIRouter, Request
from penumbra_scene.errors import Problem
from penumbra_scene.quote import Quote
from starlette.concurrency import run_in_threadpool

from penumbra_service.api.bodies import parse_submission, read_json
from penumbra_service.api.jobs import service_of
from penumbra_service.api.openapi import JOB_BODY, QUOTE_ANSWER

router = APIRouter(prefix="/v1", tags=["jobs"])
_PROBLEM: Final[dict[str, Any]] = {"model": Problem, "description": "A problem (application/problem+json)"}
_REFUSALS: Final[dict[int | str, dict[str, Any]]] = dict.fromkeys((400, 413, 415, 422, 500, 503), _PROBLEM)


@router.post("/quotes", responses={200: QUOTE_ANSWER, **_REFUSALS}, openapi_extra=JOB_BODY)
async def quote(request: Request) -> Quote:
    """What a scene would cost: relative errors, each with the samples and seconds that it takes.

    The body is what would be submitted as a job. A pilot of some two seconds is rendered ahead of all jobs on the
    devices at hand; nothing of it goes into a later picture. Compiling comes on top, and is told apart: the
    answer may take as long as that.
    """
    service = service_of(request)
    limit, settings = service.settings.max_body_bytes, service.settings
    sent = await read_json(request, limit, lambda body: parse_submission(body, settings, service.assets))
    return await run_in_threadpool(service.quote, sent.request)
