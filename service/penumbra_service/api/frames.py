"""Routes of the frames of a job that has several, and of what it makes of them all."""

from __future__ import annotations

from typing import Annotated, Any, Final

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import FileResponse, Response
from penumbra_scene.errors import Problem
from penumbra_scene.job import FramePage, FrameStatus
from starlette.concurrency import run_in_threadpool

from penumbra_service.api.jobs import service_of
from penumbra_service.api.results import answer
from penumbra_service.images.movie import movie_program
from penumbra_service.results import CONTACT_SHEET, HEATMAP, MOVIE, RECEIPT, RESULT, THUMBNAIL, frame_folder
from penumbra_service.service import RenderService
from penumbra_service.status import frame_numbers, frame_status
from penumbra_service.store.frames import FrameRow
from penumbra_service.store.jobs import JobRow

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["frames"])
MAX_FRAME_PAGE: Final = 1000
_MISSING: Final[dict[int | str, dict[str, Any]]] = {
    404: {"model": Problem, "description": "A problem (application/problem+json)"}
}
Number = Annotated[int, Path(ge=0, le=9_999_999, description="a frame's number")]


@router.get("/frames", responses=_MISSING)
@router.head("/frames", include_in_schema=False)
def frames(
    request: Request,
    job_id: str,
    after: Annotated[int, Query(ge=-1, description="`next` of the page before")] = -1,
    limit: Annotated[int, Query(ge=1, le=MAX_FRAME_PAGE)] = 100,
) -> FramePage:
    """The frames of a job, by number, those that wait too. A job that makes a single picture has none."""
    service = service_of(request)
    job = service.jobs.get(job_id)
    numbers = [number for number in frame_numbers(job) if number > after]
    items = frame_statuses(service, job, numbers[:limit])
    return FramePage(items=items, next=numbers[limit - 1] if len(numbers) > limit else None)


def frame_statuses(service: RenderService, job: JobRow, numbers: list[int]) -> tuple[FrameStatus, ...]:
    """How these frames stand; `numbers` rise."""
    if not numbers:
        return ()
    rows = {row.number: row for row in service.frames.of_job(job.id, numbers[0] - 1, numbers[-1] + 1)}
    return tuple(frame_status(job, number, rows.get(number)) for number in numbers)


@router.get("/frames/{number}", responses=_MISSING)
@router.head("/frames/{number}", include_in_schema=False)
def frame(request: Request, job_id: str, number: Number) -> FrameStatus:
    """How a frame stands."""
    service = service_of(request)
    job = service.jobs.get(job_id)
    return frame_status(job, number, _row(service, job, number))


def _row(service: RenderService, job: JobRow, number: int) -> FrameRow | None:
    return next(iter(service.frames.of_job(job.id, number - 1, number + 1)), None)


@router.get("/frames/{number}/result.exr", response_class=FileResponse, responses=_MISSING)
@router.head("/frames/{number}/result.exr", include_in_schema=False)
async def frame_exr(request: Request, job_id: str, number: Number) -> Response:
    """The frame's picture with its variance, once it is done."""
    return await _of_frame(request, job_id, number, RESULT)


@router.get("/frames/{number}/thumbnail.png", response_class=FileResponse, responses=_MISSING)
@router.head("/frames/{number}/thumbnail.png", include_in_schema=False)
async def frame_thumbnail(request: Request, job_id: str, number: Number) -> Response:
    """The frame as people look at it; it gets better while the frame is rendered."""
    return await _of_frame(request, job_id, number, THUMBNAIL)


@router.get("/frames/{number}/heatmap.png", response_class=FileResponse, responses=_MISSING)
@router.head("/frames/{number}/heatmap.png", include_in_schema=False)
async def frame_heatmap(request: Request, job_id: str, number: Number) -> Response:
    """Where the frame is how noisy."""
    return await _of_frame(request, job_id, number, HEATMAP)


@router.get("/frames/{number}/receipt.json", response_class=FileResponse, responses=_MISSING)
@router.head("/frames/{number}/receipt.json", include_in_schema=False)
async def frame_receipt(request: Request, job_id: str, number: Number) -> Response:
    """What the frame was, what it cost, and how wrong it is, once it is done."""
    return await _of_frame(request, job_id, number, RECEIPT)


async def _of_frame(request: Request, job_id: str, number: int, name: str) -> Response:
    return await run_in_threadpool(_answer_frame, request, job_id, number, name)


def _answer_frame(request: Request, job_id: str, number: int, name: str) -> Response:
    service = service_of(request)
    job = service.jobs.get(job_id)
    stands = frame_status(job, number, _row(service, job, number)).state
    missing = f"frame {number} of job {job_id} has no {name}: it is {stands}"
    return answer(request, service, job_id, f"{frame_folder(number)}/{name}", missing)


@router.get("/contact_sheet.png", response_class=FileResponse, responses=_MISSING)
@router.head("/contact_sheet.png", include_in_schema=False)
async def contact_sheet(request: Request, job_id: str) -> Response:
    """The finished frames of a job on one page, with their numbers; it fills while the job runs."""
    return await run_in_threadpool(_answer_whole, request, job_id, CONTACT_SHEET)


@router.get("/preview.mp4", response_class=FileResponse, responses=_MISSING)
@router.head("/preview.mp4", include_in_schema=False)
async def movie(request: Request, job_id: str) -> Response:
    """The frames of a job as a movie, once the job has ended, where the service has ffmpeg."""
    return await run_in_threadpool(_answer_whole, request, job_id, MOVIE)


def _answer_whole(request: Request, job_id: str, name: str) -> Response:
    service = service_of(request)
    job = service.jobs.get(job_id)
    why = f"it is {job.state}" if frame_numbers(job) else "it makes a single picture"
    if name == MOVIE and frame_numbers(job) and movie_program() is None:
        why = "the service finds no ffmpeg to make one"
    return answer(request, service, job_id, name, f"job {job_id} has no {name}: {why}")
