"""Reads JSON bodies: the right media type, within the limit, parsed away from the event loop."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from fastapi import Request
from penumbra_kernels.assets import AssetError
from penumbra_scene.check import asset_refs, inline_triangles, too_many_triangles
from penumbra_scene.errors import (
    ProblemError,
    ProblemItem,
    invalid_document,
    problem_from_validation,
    shorten,
)
from penumbra_scene.job import JobChange, JobRequest
from penumbra_scene.parse import job_from_json, parse_json, scene_from_json
from penumbra_scene.scene import Scene
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from penumbra_service.api.problems import refuse
from penumbra_service.images.assets import FolderAssets
from penumbra_service.job_limits import beyond
from penumbra_service.settings import Settings

T = TypeVar("T")
_OF_SCENES = frozenset({"version", "camera", "shapes"})
"""Keys by which a document is told to be a scene, not a job."""


@dataclass(frozen=True)
class Submission:
    """A checked job and the text that says it, as a job's document."""

    request: JobRequest
    text: str
    digest: str
    """SHA-256 of the document, whatever its white space and order of keys."""


async def read_json(request: Request, limit: int, parse: Callable[[bytes], T]) -> T:
    """What `parse` makes of the body, in a worker thread. Raises ProblemError."""
    _check_media_type(request)
    body = await read_body(request, limit)
    return await run_in_threadpool(parse, body)


async def read_body(request: Request, limit: int) -> bytes:
    """The body. Raises ProblemError (413) as soon as it is too long."""
    announced = request.headers.get("content-length", "")
    if announced.isdigit() and int(announced) > limit:
        raise _too_large(f"{int(announced)} bytes", limit)
    chunks, size = [], 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > limit:
            raise _too_large(f"more than {limit} bytes", limit)
        chunks.append(chunk)
    return b"".join(chunks)


def _too_large(given: str, limit: int) -> ProblemError:
    return refuse(413, f"given {given}, accepted at most {limit}", "The body is too long")


def _check_media_type(request: Request) -> None:
    given = request.headers.get("content-type")
    kind = (given or "application/json").partition(";")[0].strip().lower()
    if kind != "application/json" and not (kind.startswith("application/") and kind.endswith("+json")):
        detail = f"given {given}, accepted: application/json (with curl: -H 'Content-Type: application/json')"
        raise refuse(415, detail)
    check_coding(request)


def check_coding(request: Request) -> None:
    """Nothing here is unpacked: its length would have no limit. Raises ProblemError (415)."""
    coding = request.headers.get("content-encoding", "").strip()
    if coding.lower() not in ("", "identity"):
        raise refuse(415, f"given Content-Encoding: {coding[:80]}, accepted: none, or identity")


def parse_submission(body: bytes, settings: Settings, assets: FolderAssets) -> Submission:
    """A job from {"scene": ...}, or from a bare scene. Raises ProblemError."""
    document = parse_json(body, settings.max_body_bytes)
    bare = (
        isinstance(document, dict) and "scene" not in document and not document.keys().isdisjoint(_OF_SCENES)
    )
    if bare:
        scene_from_json(document)  # so that pointers fit what was sent
        document = {"scene": document}
    request = job_from_json(document)
    base = "" if bare else "/scene"
    if too_much := beyond(request, settings, base):
        raise ProblemError(invalid_document(too_much, "job"))
    check_assets(request.resolved_scene(), assets, base)
    text = json.dumps(document, separators=(",", ":"))
    return Submission(request, text, _digest(document))


def parse_change(body: bytes, limit: int) -> JobChange:
    """What shall change about a job. Raises ProblemError."""
    document = parse_json(body, limit)
    try:
        return JobChange.model_validate(document)
    except ValidationError as error:
        raise ProblemError(problem_from_validation(error, document, "change")) from None


def parse_for_validation(body: bytes, settings: Settings, assets: FolderAssets) -> Scene:
    """The scene as it would be rendered, from what would be submitted. Raises ProblemError."""
    return parse_submission(body, settings, assets).request.resolved_scene()


def _digest(document: Any) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def check_assets(scene: Scene, assets: FolderAssets, base: str) -> None:
    """Decodes every asset that the scene names (or finds it decoded). Raises ProblemError (422)."""
    items = []
    known: dict[tuple[str, str | None], str | None] = {}
    sizes: dict[str | None, int] = {}
    triangles = inline_triangles(scene)
    for pointer, ref in asset_refs(scene):
        use = ("mesh" if pointer.endswith("/source") else "image", ref.asset)
        if use not in known:
            try:
                if use[0] == "mesh":
                    sizes[ref.asset] = len(assets.mesh(ref).indices)
                else:
                    assets.image(ref)
                known[use] = None
            except AssetError as error:
                known[use] = str(error)
        triangles += sizes.get(ref.asset, 0) if use[0] == "mesh" else 0
        message = known[use]
        if message is not None:
            accepted = "the sha256 of an asset that was uploaded to /v1/assets and can be read as " + use[0]
            items.append(
                ProblemItem(
                    pointer=f"{base}{pointer}/asset",
                    message=message,
                    given=shorten(ref.asset),
                    accepted=accepted,
                )
            )
    crowded = too_many_triangles(triangles)
    if crowded is not None:
        at = base + crowded.pointer
        items.append(
            ProblemItem(pointer=at, message=crowded.message, given=crowded.given, accepted=crowded.accepted)
        )
    if items:
        raise ProblemError(invalid_document(items, "scene"))
