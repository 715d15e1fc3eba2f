"""The web pages: jobs, one job, submit, devices, the API, log in. Plain HTML that scripts only make livelier.

Pages read through the service object that the API uses. No page needs a script to be read, or anything from
another host: the content security policy forbids both inline scripts and foreign ones.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Final

from fastapi import APIRouter, FastAPI, Form, Query, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from fastapi.staticfiles import StaticFiles
from fastapi.templating import Jinja2Templates
from penumbra_scene.check import check_scene, scene_hash
from penumbra_scene.errors import Problem, ProblemError
from penumbra_scene.job import JobState
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile

from penumbra_service.api.bodies import Submission, parse_submission
from penumbra_service.api.guard import COOKIE, LOGIN_PATH
from penumbra_service.api.reference import in_html, routes_by_tag
from penumbra_service.service import (
    ConflictError,
    QueueFullError,
    QuotaUsedError,
    RenderService,
    new_job,
)
from penumbra_service.store.ids import is_id
from penumbra_service.store.jobs import JobRow, NoSuchJobError
from penumbra_service.web import words
from penumbra_service.web.locate import line_of
from penumbra_service.web.pages import PAGE_LENGTH, page_of, view_of
from penumbra_service.web.quotes import quote_view

HERE: Final = Path(__file__).parent
STATIC: Final = HERE / "static"
COOKIE_SECONDS: Final = 30 * 24 * 3600
ACTIONS: Final = ("cancel", "pause", "resume")
_AT_WORK: Final = (JobState.RENDERING, JobState.COMPILING, JobState.FINISHING)
_OTHERS: Final = tuple(state for state in JobState if state not in _AT_WORK)
_FORM_SLACK: Final = 4096
"""Bytes of a form besides its document."""

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; media-src 'self'; connect-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)
_templates: Final = Jinja2Templates(directory=HERE / "templates")
_templates.env.globals["words"] = words
_templates.env.filters["in_html"] = in_html
_templates.env.trim_blocks = True
_templates.env.lstrip_blocks = True


def install(app: FastAPI) -> None:
    """Serves the style sheet and the scripts."""
    app.mount("/static", StaticFiles(directory=STATIC), name="static")


@lru_cache
def _static_version() -> str:
    """Changes with any static file, so that browsers may keep what they have until then."""
    digest = hashlib.sha256()
    for path in sorted(STATIC.iterdir()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


_templates.env.globals["static_version"] = _static_version


def _service(request: Request) -> RenderService:
    service: RenderService = request.app.state.service
    return service


def _page(request: Request, name: str, status: int = 200, **context: Any) -> Response:
    context["logged_in"] = getattr(request.state, "api_key", None) is not None
    return _templates.TemplateResponse(request, name, context, status_code=status, headers=HEADERS)


def _job_row(service: RenderService, job_id: str) -> JobRow | None:
    try:
        return service.jobs.get(job_id)
    except NoSuchJobError:
        return None


def _no_such_job(request: Request, job_id: str) -> Response:
    return _page(request, "missing.html", 404, what=f"There is no job {job_id}")


@router.get("/")
@router.head("/")
def home() -> Response:
    """The first page is that of the jobs."""
    return RedirectResponse("/jobs", 303)


@router.get("/favicon.ico")
def icon() -> Response:
    """Old browsers ask for it here."""
    return RedirectResponse("/static/icon.svg", 301)


@router.get("/jobs")
def jobs(
    request: Request,
    state: Annotated[JobState | None, Query()] = None,
    before: Annotated[str | None, Query(max_length=64)] = None,
) -> Response:
    """Jobs that are worked on, then all others, newest first; with `before`, others older than that one."""
    return _page(request, "jobs.html", **_list(request, state, before))


@router.get("/jobs/cards")
def cards(request: Request, state: Annotated[JobState | None, Query()] = None) -> Response:
    """The first page's jobs, without the page around them."""
    return _page(request, "_cards.html", **_list(request, state, None))


def _list(request: Request, state: JobState | None, before: str | None) -> dict[str, Any]:
    service = _service(request)
    before = before if before is not None and is_id(before) else None
    rows = service.jobs.page(_OTHERS if state is None else [state], before, PAGE_LENGTH + 1)
    at_work = service.jobs.waiting(_AT_WORK) if state is None and before is None else []
    return {
        "jobs": [view_of(row) for row in (*at_work, *rows[:PAGE_LENGTH])],
        "older": rows[PAGE_LENGTH - 1].id if len(rows) > PAGE_LENGTH else None,
        "before": before,
        "chosen": state,
        "states": words.STATES,
        "counts": service.jobs.counts(),
    }


@router.get("/jobs/{job_id}")
def job(request: Request, job_id: str, after: Annotated[int, Query(ge=-1, le=9_999_999)] = -1) -> Response:
    """A job: its picture, its noise, its error as it falls, its receipt; or its frames, those above `after`."""
    row = _job_row(_service(request), job_id)
    if row is None:
        return _no_such_job(request, job_id)
    return _page(request, "job.html", after=after, view=page_of(_service(request), row, after))


@router.get("/jobs/{job_id}/{part}")
def job_part(
    request: Request, job_id: str, part: str, after: Annotated[int, Query(ge=-1, le=9_999_999)] = -1
) -> Response:
    """What changes on a page while a job runs: its `card`, or `live` and `actions` of its own page."""
    row = _job_row(_service(request), job_id)
    if row is None or part not in ("card", "live", "actions"):
        return _no_such_job(request, job_id)
    if part == "live":
        return _page(request, "_live.html", view=page_of(_service(request), row, after))
    return _page(request, f"_{part}.html", job=view_of(row))


@router.post("/jobs/{job_id}/{action}")
def act(request: Request, job_id: str, action: str) -> Response:
    """A button of a job's page: cancel, pause or resume."""
    service = _service(request)
    if action not in ACTIONS:
        return _no_such_job(request, job_id)
    try:
        getattr(service, action)(job_id)
    except NoSuchJobError:
        return _no_such_job(request, job_id)
    except ConflictError as error:
        return _page(request, "missing.html", 409, what=str(error))
    return RedirectResponse(f"/jobs/{job_id}", 303)


@router.get("/submit")
def submit_page(request: Request) -> Response:
    """A form for a scene."""
    return _page(request, "submit.html", text="", problem=None)


@router.post("/submit")
async def submit(request: Request) -> Response:
    """Checks the scene, says what it would cost, or renders it. What is wrong is shown beside the text that was
    sent."""
    service = _service(request)
    limit = service.settings.max_body_bytes
    async with request.form(max_files=1, max_fields=8, max_part_size=limit + _FORM_SLACK) as form:
        text = await _document(form.get("document"), form.get("file"))
        action = form.get("action")
    try:
        sent = await run_in_threadpool(parse_submission, text, service.settings, service.assets)
    except ProblemError as error:
        return await run_in_threadpool(_refused, request, text, error.problem)
    if action == "check":
        return await run_in_threadpool(_checked, request, text, sent)
    if action == "quote":
        return await run_in_threadpool(_quoted, request, text, sent)
    key = getattr(request.state, "api_key", None)
    made = new_job(sent.request, sent.text, sent.digest, None if key is None else str(key.id), None)
    try:
        row, _ = await run_in_threadpool(service.submit, made)
    except (QueueFullError, QuotaUsedError) as error:
        return _page(
            request, "missing.html", 403 if isinstance(error, QuotaUsedError) else 429, what=str(error)
        )
    return RedirectResponse(f"/jobs/{row.id}", 303)


async def _document(pasted: Any, file: Any) -> bytes:
    """What was pasted, or, if that is empty, the file."""
    text = pasted if isinstance(pasted, str) else ""
    if not text.strip() and isinstance(file, UploadFile):
        return bytes(await file.read())
    return text.encode("utf-8", "surrogatepass")


def _refused(request: Request, body: bytes, problem: Problem) -> Response:
    text = body.decode("utf-8", "replace")
    items = [(item, line_of(text, item.pointer)) for item in problem.errors]
    return _page(request, "submit.html", problem.status, text=text, problem=problem, items=items)


def _checked(request: Request, body: bytes, sent: Submission) -> Response:
    scene = sent.request.resolved_scene()
    found = {
        "hash": scene_hash(scene),
        "warnings": [finding for finding in check_scene(scene) if finding.warning],
    }
    return _page(request, "submit.html", text=body.decode("utf-8"), problem=None, found=found)


def _quoted(request: Request, body: bytes, sent: Submission) -> Response:
    text = body.decode("utf-8")
    try:
        quote = _service(request).quote(sent.request)
    except ProblemError as error:
        return _page(request, "submit.html", error.problem.status, text=text, problem=error.problem, items=[])
    return _page(request, "submit.html", text=text, problem=None, quote=quote_view(quote))


@router.get("/devices")
def devices(request: Request) -> Response:
    """The OpenCL devices that render."""
    return _page(request, "devices.html", devices=_service(request).runner.devices())


@router.get("/docs")
def api_reference(request: Request) -> Response:
    """Every route with its parameters, answers and an example, from the OpenAPI document."""
    schema = request.app.openapi()
    return _page(request, "docs.html", info=schema["info"], groups=routes_by_tag(schema))


@router.get(LOGIN_PATH)
def login_page(request: Request) -> Response:
    """Asks for a key."""
    return _page(request, "login.html", wrong=False)


@router.post(LOGIN_PATH)
async def login(request: Request, key: Annotated[str, Form(max_length=500)]) -> Response:
    """Keeps a valid key in a cookie that no script can read."""
    token = key.strip()
    if await run_in_threadpool(_service(request).keys.check, token) is None:
        return _page(request, "login.html", 401, wrong=True)
    response = RedirectResponse("/jobs", 303)
    secure = request.url.scheme == "https"
    response.set_cookie(
        COOKIE, token, max_age=COOKIE_SECONDS, secure=secure, httponly=True, samesite="strict"
    )
    return response


@router.post("/logout")
def logout() -> Response:
    """Forgets the key."""
    response = RedirectResponse(LOGIN_PATH, 303)
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return response
