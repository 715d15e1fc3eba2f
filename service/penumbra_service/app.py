"""The HTTP application. It never imports pyopencl: devices live in processes of their own."""

from __future__ import annotations

import importlib
import importlib.util
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Final

from fastapi import FastAPI
from penumbra_scene.job import JobRequest
from starlette.concurrency import run_in_threadpool

from penumbra_service.api import assets, events, frames, jobs, openapi, problems, quotes, results, system
from penumbra_service.api.guard import Guard
from penumbra_service.api.limits import LimitBodies
from penumbra_service.api.metrics import CountRequests, Metrics
from penumbra_service.running import Runner
from penumbra_service.service import RenderService
from penumbra_service.settings import Settings, SettingsError

_DESCRIPTION: Final = (
    "Scene JSON in, an EXR with trustworthy variance out. Every error is `application/problem+json` and "
    "names the place in the document (JSON pointer), what was given and what is accepted."
)


class PublicWithoutKeyError(SettingsError):
    """The service would be open to the network without a key."""


def create_app(settings: Settings, runner: Runner | None = None) -> FastAPI:
    """The application; its service is in `app.state.service`, and devices start with its
    lifespan.

    Raises PublicWithoutKeyError. `runner` renders the jobs; by default the local devices do.
    """
    service = RenderService(settings, runner or _local_runner(settings))
    if settings.initial_key:
        service.keys.admit("initial", settings.initial_key)
    if settings.public and not service.keys.any_active():
        service.database.close()
        raise PublicWithoutKeyError(
            f"other machines can reach the host {settings.host!r}, and there is no API key to guard it. "
            f"Make one with `{settings.keys_command('create NAME')}`, or listen on 127.0.0.1 (the default)."
        )
    app = FastAPI(
        title="Penumbra",
        version=system.VERSION,
        description=_DESCRIPTION,
        lifespan=_lifespan,
        redirect_slashes=False,
        docs_url=None,  # its page loads scripts from elsewhere; the pages' own /docs works offline
        redoc_url=None,
    )
    app.state.service = service
    app.state.metrics = Metrics(service)
    problems.install(app)
    openapi.install(app)
    for module in (jobs, quotes, results, frames, events, assets, system):
        app.include_router(module.router)
    _add_pages(app)
    app.add_middleware(LimitBodies, settings=settings)
    app.add_middleware(Guard, service=service)
    app.add_middleware(CountRequests, metrics=app.state.metrics)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    service: RenderService = app.state.service
    await run_in_threadpool(service.start)
    # The first document that comes would have to wait for its validator to be built.
    threading.Thread(target=JobRequest.model_rebuild, name="penumbra-models", daemon=True).start()
    try:
        yield
    finally:
        await run_in_threadpool(service.stop)


def _local_runner(settings: Settings) -> Runner:
    from penumbra_service.local_runner import LocalRunner

    local: Runner = LocalRunner(settings)
    return local


def _add_pages(app: FastAPI) -> None:
    """The web pages, where the package brings them."""
    if importlib.util.find_spec("penumbra_service.web.routes") is None:
        return
    pages: Any = importlib.import_module("penumbra_service.web.routes")
    app.include_router(pages.router)
    if hasattr(pages, "install"):
        pages.install(app)
