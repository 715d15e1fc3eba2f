"""Every error leaves as problem+json, whoever raised it."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from penumbra_scene.errors import MEDIA_TYPE, Problem, ProblemError, ProblemItem, make_problem, shorten
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match

from penumbra_service.service import ConflictError, QueueFullError, QuotaUsedError
from penumbra_service.store.artifacts import NoSuchArtifactError
from penumbra_service.store.assets import AssetDigestError, AssetTooLargeError
from penumbra_service.store.content import NoSuchAssetError
from penumbra_service.store.frames import NoSuchFrameError
from penumbra_service.store.jobs import IdempotencyConflictError, NoSuchJobError

log = logging.getLogger(__name__)

RETRY_AFTER: Final = "30"
"""Seconds after which somebody whom the queue had no room for may ask again."""
_METHODS: Final = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
_KINDS: Final = {
    400: "bad-request",
    401: "unauthorized",
    403: "forbidden",
    404: "not-found",
    405: "method-not-allowed",
    408: "timeout",
    409: "conflict",
    413: "too-large",
    415: "unsupported-media-type",
    416: "range-not-satisfiable",
    422: "invalid-request",
    500: "internal",
    503: "unavailable",
}


def problem_response(problem: Problem, headers: Mapping[str, str] | None = None) -> Response:
    """The answer that tells of a problem."""
    text = problem.model_dump_json()
    return Response(text, problem.status, dict(headers or {}), MEDIA_TYPE)


def plain_problem(status: int, detail: str, title: str | None = None) -> Problem:
    """A problem that needs no place in a document."""
    kind = _KINDS.get(status, "server-error" if status >= 500 else "bad-request")
    return make_problem(kind, title or HTTPStatus(status).phrase, status, detail)


def refuse(status: int, detail: str, title: str | None = None) -> ProblemError:
    """To be raised by a route."""
    return ProblemError(plain_problem(status, detail, title))


def install(app: FastAPI) -> None:
    """Has the application answer every exception with a problem."""
    app.add_exception_handler(ProblemError, _problem)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(Exception, _internal)
    for missing in (NoSuchJobError, NoSuchFrameError, NoSuchArtifactError, NoSuchAssetError):
        app.add_exception_handler(missing, _missing)
    app.add_exception_handler(QueueFullError, _queue_full)
    app.add_exception_handler(QuotaUsedError, _quota_used)
    for conflict in (ConflictError, IdempotencyConflictError):
        app.add_exception_handler(conflict, _conflict)
    app.add_exception_handler(AssetTooLargeError, _too_large)
    app.add_exception_handler(AssetDigestError, _wrong_digest)
    app.add_exception_handler(ClientDisconnect, _gone)


async def _problem(_request: Request, error: Exception) -> Response:
    assert isinstance(error, ProblemError)
    return problem_response(error.problem)


async def _gone(request: Request, _error: Exception) -> Response:
    """The caller left before the body had come: no mistake of ours, and nobody reads an answer."""
    log.info("%s %s: the caller left before the body had come", request.method, request.url.path)
    return Response(status_code=400)


async def _http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    detail = str(error.detail)
    if error.status_code == 404 and detail == HTTPStatus.NOT_FOUND.phrase:
        detail = f"there is nothing at {request.url.path}; /docs lists what there is"
    headers = dict(error.headers or {})
    if error.status_code == 405:
        headers["Allow"] = ", ".join(_methods(request)) or headers.get("Allow", "")
        detail = (
            f"given {request.method} {request.url.path}, accepted: {headers['Allow'] or 'another method'}"
        )
    return problem_response(plain_problem(error.status_code, detail), headers)


def _methods(request: Request) -> list[str]:
    """Those that any route takes there: a path may have several, of which the first one answers."""
    routes, scope = request.app.routes, dict(request.scope)
    return [m for m in _METHODS if any(r.matches({**scope, "method": m})[0] is Match.FULL for r in routes)]


async def _invalid(_request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    items = [_item(entry) for entry in error.errors()]
    count = "1 error" if len(items) == 1 else f"{len(items)} errors"
    return problem_response(make_problem("invalid-request", "The request is not valid", 422, count, items))


def _item(entry: Mapping[str, Any]) -> ProblemItem:
    """Places in the URL and in headers have no JSON pointer: the message names them."""
    where, *path = entry["loc"]
    message = str(entry["msg"]).removeprefix("Value error, ").replace("Input should", "must")
    given = json.dumps(entry["input"]) if isinstance(entry.get("input"), str) else shorten(entry.get("input"))
    if where == "body":
        return ProblemItem(pointer="".join(f"/{part}" for part in path), message=message, given=given)
    name = "/".join(str(part) for part in path)
    return ProblemItem(
        pointer="", message=f"{where} parameter {name}: {message}", given=given, accepted=_accepted(entry)
    )


def _accepted(entry: Mapping[str, Any]) -> str:
    """What a parameter may be, of the kinds that routes have."""
    context = entry.get("ctx", {})
    plain = {"int_parsing": "a whole number", "missing": "a value"}
    told = {
        "ge": "a number of at least {}",
        "le": "a number of at most {}",
        "expected": "{}",
        "pattern": "text matching {}",
        "min_length": "at least {} characters",
        "max_length": "at most {} characters",
    }
    words = [text.format(context[key]) for key, text in told.items() if key in context]
    return plain.get(str(entry["type"]), ", ".join(words))


async def _missing(_request: Request, error: Exception) -> Response:
    words: dict[type[Exception], str] = {
        NoSuchJobError: f"there is no job {error}",
        NoSuchAssetError: f"there is no asset {error}",
    }
    return problem_response(plain_problem(404, words.get(type(error), str(error))))


async def _conflict(_request: Request, error: Exception) -> Response:
    return problem_response(plain_problem(409, str(error)))


async def _queue_full(_request: Request, error: Exception) -> Response:
    problem = make_problem("queue-full", "The queue is full", 429, str(error))
    return problem_response(problem, {"Retry-After": RETRY_AFTER})


async def _quota_used(_request: Request, error: Exception) -> Response:
    return problem_response(make_problem("quota-used", "The quota is used up", 403, str(error)))


async def _too_large(_request: Request, error: Exception) -> Response:
    return problem_response(plain_problem(413, str(error)), {"Connection": "close"})


async def _wrong_digest(_request: Request, error: Exception) -> Response:
    assert isinstance(error, AssetDigestError)
    detail = f"the body's SHA-256 is {error.actual}; the address says {error.expected}"
    return problem_response(make_problem("wrong-digest", "The asset is another one", 422, detail))


async def _internal(request: Request, error: Exception) -> Response:
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    return problem_response(plain_problem(500, "the service failed at this; its log says more"))
