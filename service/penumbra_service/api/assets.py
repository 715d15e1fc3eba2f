"""Routes of assets: upload by content, look up."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import FileResponse
from penumbra_kernels.assets import AssetError
from penumbra_scene.assets import AssetRef
from penumbra_scene.job import AssetInfo
from starlette.concurrency import run_in_threadpool

from penumbra_service.api.bodies import check_coding
from penumbra_service.api.jobs import owner_of, service_of
from penumbra_service.api.problems import refuse
from penumbra_service.api.results import RangedFile
from penumbra_service.images.formats import (
    HEAD_BYTES,
    IMAGE_FORMATS,
    MESH_FORMATS,
    image_format,
    mesh_format,
)
from penumbra_service.service import RenderService
from penumbra_service.store.assets import StoredAsset, Upload

router = APIRouter(prefix="/v1/assets", tags=["assets"])

Digest = Annotated[
    str, Path(pattern=r"^(sha256:)?[0-9a-f]{64}$", description="SHA-256, with or without `sha256:`")
]
_BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post("", status_code=201, openapi_extra=_BODY)
async def upload(request: Request, response: Response) -> AssetInfo:
    """Upload an asset as the bare body (with curl: `--data-binary @file`): OBJ, PLY, GLB, or an image.

    The same bytes sent twice are one asset (200 instead of 201).
    """
    return await _receive(request, response, None)


@router.put("/{sha256}", status_code=201, openapi_extra=_BODY)
async def put(request: Request, response: Response, sha256: Digest) -> AssetInfo:
    """The same, refused (422) if the body has another SHA-256 than the address says."""
    return await _receive(request, response, sha256.removeprefix("sha256:"))


@router.get("/{sha256}")
@router.head("/{sha256}", include_in_schema=False)
def get(request: Request, sha256: Digest) -> AssetInfo:
    """What is known of an asset."""
    return _info(service_of(request).asset_store.get(sha256.removeprefix("sha256:")), False)


@router.get("/{sha256}/content", response_class=FileResponse)
@router.head("/{sha256}/content", include_in_schema=False)
def content(request: Request, sha256: Digest) -> FileResponse:
    """The bytes of an asset."""
    digest = sha256.removeprefix("sha256:")
    path = service_of(request).asset_store.path(digest)
    headers = {"ETag": f'"{digest}"', "X-Content-Type-Options": "nosniff"}
    return RangedFile(path, headers=headers, media_type="application/octet-stream", filename=digest)


async def _receive(request: Request, response: Response, expected: str | None) -> AssetInfo:
    service = service_of(request)
    if request.headers.get("content-type", "").startswith("multipart/"):
        raise refuse(415, "send the file as the bare body, not as a form (with curl: --data-binary @file)")
    check_coding(request)
    announced = request.headers.get("content-length", "")
    limit = service.settings.max_asset_bytes
    if announced.isdigit() and int(announced) > limit:
        raise refuse(413, f"given {int(announced)} bytes, accepted at most {limit}", "The asset is too large")
    with service.asset_store.upload() as sink:
        async for chunk in request.stream():
            await run_in_threadpool(sink.write, chunk)
        asset, created = await run_in_threadpool(_keep, service, sink, expected, owner_of(request))
    response.status_code = 201 if created else 200
    response.headers["Location"] = f"/v1/assets/sha256:{asset.sha256}"
    return _info(asset, created)


def _keep(
    service: RenderService, sink: Upload, expected: str | None, owner: str | None
) -> tuple[StoredAsset, bool]:
    """Files what came, if it can be decoded. Raises ProblemError (422), AssetDigestError."""
    service.asset_store.place(sink, expected)
    try:
        asset = _describe(service, sink)
    except AssetError as error:
        service.asset_store.discard(sink.sha256)
        raise refuse(422, str(error), "The asset cannot be read") from None
    return service.asset_store.record(asset, owner)


def _describe(service: RenderService, sink: Upload) -> StoredAsset:
    ref = AssetRef(asset=f"sha256:{sink.sha256}")
    with service.asset_store.open_placed(sink.sha256) as file:
        head = file.read(HEAD_BYTES)
    if (kind := image_format(head)) is not None:
        pixels = service.assets.image(ref).pixels
        return StoredAsset(
            sink.sha256, sink.size, "image", kind, f"{pixels.shape[1]} x {pixels.shape[0]} pixels"
        )
    if (kind := mesh_format(head)) is not None:
        return StoredAsset(
            sink.sha256, sink.size, "mesh", kind, f"{len(service.assets.mesh(ref).indices)} triangles"
        )
    given = "nothing" if sink.size == 0 else f"{sink.size} bytes of another kind"
    raise AssetError(f"given {given}; accepted: {MESH_FORMATS}, {IMAGE_FORMATS}")


def _info(asset: StoredAsset, created: bool) -> AssetInfo:
    return AssetInfo(
        asset=f"sha256:{asset.sha256}",
        bytes=asset.bytes,
        kind=asset.kind,
        format=asset.format,
        detail=asset.detail,
        created=created,
    )
