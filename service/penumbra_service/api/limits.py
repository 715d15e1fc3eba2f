"""Bodies have an end: no route, form or log-in page reads more than the settings allow into memory or onto
the disk.

Uploads of assets count their own bytes as they stream them to a file; everything else passes here.
"""

from __future__ import annotations

from typing import Final

from fastapi import HTTPException
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from penumbra_service.api.guard import LOGIN_PATH
from penumbra_service.api.problems import plain_problem, problem_response
from penumbra_service.settings import Settings

FORM_BYTES: Final = 64 * 1024
"""What a form may add to the document in it: boundaries, names, the other fields."""
LOGIN_BYTES: Final = 4096
"""The one body that is read from callers without a key."""
_OWN_LIMIT: Final = "/v1/assets"


class LimitBodies:
    """ASGI middleware: 413 for a body that is announced, or turns out, to be too long."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        # The submit page sends a chosen file twice: as the file, and as the text that it was shown as.
        self._most = 2 * settings.max_body_bytes + FORM_BYTES

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        limit = self._limit(scope)
        if limit is None:
            await self._app(scope, receive, send)
            return
        announced = Headers(scope=scope).get("content-length", "")
        if announced.isdigit() and int(announced) > limit:
            response = problem_response(
                plain_problem(413, _detail(announced, limit)), {"Connection": "close"}
            )
            await response(scope, receive, send)
            return
        await self._app(scope, _counted(receive, limit), send)

    def _limit(self, scope: Scope) -> int | None:
        if scope["type"] != "http":
            return None
        path = scope["path"]
        if path == _OWN_LIMIT or path.startswith(_OWN_LIMIT + "/"):
            return None
        return LOGIN_BYTES if path == LOGIN_PATH else self._most


def _counted(receive: Receive, limit: int) -> Receive:
    size = 0

    async def counted() -> Message:
        nonlocal size
        message = await receive()
        size += len(message.get("body", b""))
        if size > limit:
            raise HTTPException(413, _detail(f"more than {limit}", limit), {"Connection": "close"})
        return message

    return counted


def _detail(given: str, limit: int) -> str:
    return f"given {given} bytes, accepted at most {limit}"
