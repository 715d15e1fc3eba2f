"""The gate before every route: names, keys, and requests that another site's page sends in a visitor's name.

- Bound to loopback and without keys, the service answers only to names of this machine, so that a web
  page whose name was made to point here (DNS rebinding) gets nothing.
- A request that changes something must not come from another origin's page.
- Once a key was made, or if other machines can reach the service, /v1 and the pages need a key: as a
  bearer token, or in the cookie that the log-in page sets.
"""

from __future__ import annotations

from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import urlsplit

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from penumbra_service.api.problems import plain_problem, problem_response
from penumbra_service.service import RenderService
from penumbra_service.settings import is_loopback
from penumbra_service.store.keys import ApiKey

COOKIE: Final = "penumbra_key"
LOGIN_PATH: Final = "/login"
_OPEN: Final = ("/health", "/static/", LOGIN_PATH, "/favicon.ico")
"""Paths that need no key: they tell nothing about jobs."""
_SAFE_METHODS: Final = frozenset({"GET", "HEAD", "OPTIONS"})


class Guard:
    """ASGI middleware. Leaves the key in scope["state"]["api_key"], and in "stranger" whether one is missing."""

    def __init__(self, app: ASGIApp, service: RenderService) -> None:
        self._app = app
        self._service = service

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            headers = Headers(scope=scope)
            response = self._foreign(scope, headers) or await self._without_key(scope, headers)
            if response is not None:
                await response(scope, receive, send)
                return
        await self._app(scope, receive, send)

    async def _without_key(self, scope: Scope, headers: Headers) -> Response | None:
        """The answer to someone who should have shown a key."""
        key = await self._key(headers)
        scope.setdefault("state", {})["api_key"] = key
        stranger = key is None and await run_in_threadpool(lambda: self._service.needs_key)
        scope["state"]["stranger"] = stranger
        if not stranger or _is_open(scope["path"]):
            return None
        if scope["method"] == "GET" and "text/html" in headers.get("accept", ""):
            return RedirectResponse(LOGIN_PATH, 303)
        detail = "this service needs an API key: send the header 'Authorization: Bearer <key>'"
        return problem_response(plain_problem(401, detail), {"WWW-Authenticate": "Bearer"})

    def _foreign(self, scope: Scope, headers: Headers) -> Response | None:
        """The answer to what came under another name, or from another site's page."""
        host = headers.get("host", "")
        if not self._service.settings.public and not self._known(_name_of(host)):
            return _forbidden(
                f"this service does not go by the name {host!r}; the setting 'hosts' can add it"
            )
        origin = headers.get("origin")
        if scope["method"] not in _SAFE_METHODS and origin is not None and urlsplit(origin).netloc != host:
            return _forbidden(f"pages of {origin} may not change anything here")
        return None

    def _known(self, name: str) -> bool:
        settings = self._service.settings
        return is_loopback(name) or name == settings.host or name in settings.hosts or "*" in settings.hosts

    async def _key(self, headers: Headers) -> ApiKey | None:
        token = _token(headers)
        return None if token is None else await run_in_threadpool(self._service.keys.check, token)


def _forbidden(detail: str) -> Response:
    return problem_response(plain_problem(403, detail))


def _is_open(path: str) -> bool:
    return any(path == prefix.rstrip("/") or path.startswith(prefix.rstrip("/") + "/") for prefix in _OPEN)


def _name_of(host: str) -> str:
    """The host without its port; IPv6 addresses without brackets."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _token(headers: Headers) -> str | None:
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token.strip():
        return token.strip()
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return None if cookie is None else cookie.value
