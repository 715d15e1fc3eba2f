"""Routes of what a job leaves: pictures, receipt, scene. With ETag, conditional requests and byte ranges."""

from __future__ import annotations

import hashlib
from typing import Final

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, Response, StreamingResponse
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.responses import MalformedRangeHeader, RangeNotSatisfiable

from penumbra_service.api.jobs import service_of
from penumbra_service.results import CONTACT_SHEET, HEATMAP, MOVIE, RECEIPT, RESULT, THUMBNAIL
from penumbra_service.service import RenderService
from penumbra_service.store.artifacts import NoSuchArtifactError

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])

_MEDIA: Final = {
    RESULT: "image/x-exr",
    THUMBNAIL: "image/png",
    HEATMAP: "image/png",
    RECEIPT: "application/json",
    CONTACT_SHEET: "image/png",
    MOVIE: "video/mp4",
}


@router.get("/result.exr", response_class=FileResponse)
@router.head("/result.exr", include_in_schema=False)
async def exr(request: Request, job_id: str) -> Response:
    """The picture with its variance, once the job is done."""
    return await _artifact(request, job_id, RESULT)


@router.get("/thumbnail.png", response_class=FileResponse)
@router.head("/thumbnail.png", include_in_schema=False)
async def thumbnail(request: Request, job_id: str) -> Response:
    """The picture as people look at it; it gets better while the job runs."""
    return await _artifact(request, job_id, THUMBNAIL)


@router.get("/heatmap.png", response_class=FileResponse)
@router.head("/heatmap.png", include_in_schema=False)
async def heatmap(request: Request, job_id: str) -> Response:
    """Where the picture is how noisy."""
    return await _artifact(request, job_id, HEATMAP)


@router.get("/receipt.json", response_class=FileResponse)
@router.head("/receipt.json", include_in_schema=False)
async def receipt(request: Request, job_id: str) -> Response:
    """What the render was, what it cost, and how wrong it is, once the job is done."""
    return await _artifact(request, job_id, RECEIPT)


@router.get("/scene.json")
@router.head("/scene.json", include_in_schema=False)
async def scene(request: Request, job_id: str) -> Response:
    """The scene as it is rendered, with every default written out."""
    text = await run_in_threadpool(_scene_text, service_of(request), job_id)
    etag = f'"{hashlib.sha256(text.encode()).hexdigest()[:32]}"'
    if _known(request, etag):
        return Response(status_code=304, headers={"ETag": etag})
    return Response(text, headers={"ETag": etag}, media_type="application/json")


def _scene_text(service: RenderService, job_id: str) -> str:
    return service.request(job_id).resolved_scene().model_dump_json(indent=1)


async def _artifact(request: Request, job_id: str, name: str) -> Response:
    service = service_of(request)
    return await run_in_threadpool(_answer, request, service, job_id, name)


def _answer(request: Request, service: RenderService, job_id: str, name: str) -> Response:
    row = service.jobs.get(job_id)
    why = f"it is {row.state}"
    if row.progress.get("frames") and name in (RESULT, RECEIPT):
        why = f"each of its frames has its own, see /v1/jobs/{job_id}/frames"
    return answer(request, service, job_id, name, f"job {job_id} has no {name}: {why}")


def answer(request: Request, service: RenderService, job_id: str, name: str, missing: str) -> Response:
    """An artifact, conditionally or in part where that was asked for. Raises NoSuchArtifactError(missing)."""
    try:
        info = service.artifacts.info(job_id, name)
        path = service.artifacts.local_path(job_id, name)
    except NoSuchArtifactError:
        raise NoSuchArtifactError(missing) from None
    media = _MEDIA[name.rpartition("/")[2]]
    etag = f'"{hashlib.sha256(info.etag.encode()).hexdigest()[:32]}"'
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    if _known(request, etag):
        return Response(status_code=304, headers=headers)
    if path is not None:
        return RangedFile(path, headers=headers, media_type=media)
    headers["Content-Length"] = str(info.size)
    if request.method == "HEAD":
        return Response(headers=headers, media_type=media)
    return StreamingResponse(service.artifacts.read(job_id, name), headers=headers, media_type=media)


class RangedFile(FileResponse):
    """A file by ranges, whose refusals are problems, too."""

    @classmethod
    def _parse_range_header(cls, http_range: str, file_size: int) -> list[tuple[int, int]]:
        try:
            return super()._parse_range_header(http_range, file_size)
        except RangeNotSatisfiable:
            detail = f"given {http_range[:80]!r}, accepted: bytes of 0 to {file_size - 1}"
            raise HTTPException(416, detail, {"Content-Range": f"bytes */{file_size}"}) from None
        except MalformedRangeHeader as error:
            detail = f"Range: given {http_range[:80]!r}, accepted: such as bytes=0-99 ({error.content})"
            raise HTTPException(400, detail) from None


def _known(request: Request, etag: str) -> bool:
    """Whether the caller has this version already."""
    names = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
    return etag in names or "*" in names
