"""Bodies have an end: no route, form or log-in page reads more than the settings allow into memory or onto
the disk, or waits for bytes that do not come.

Uploads of assets count their own bytes as they stream them to a file; everything else is counted here.
"""

from __future__ import annotations

import asyncio
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
STALL_SECONDS: Final = 60.0
"""A body of which nothing comes for so long is given up."""
_OWN_LIMIT: Final = "/v1/assets"


class LimitBodies:
    """ASGI middleware: 413 for a body that is announced, or turns out, to be too long; 408 for one that stalls."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        # The submit page sends a chosen file twice: as the file, and as the text that it was shown as.
        self._most = 2 * settings.max_body_bytes + FORM_BYTES

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        limit = self._limit(scope["path"])
        announced = Headers(scope=scope).get("content-length", "")
        if limit is not None and announced.isdigit() and int(announced) > limit:
            response = problem_response(
                plain_problem(413, _detail(announced, limit)), {"Connection": "close"}
            )
            await response(scope, receive, send)
            return
        await self._app(scope, _watched(receive, limit), send)

    def _limit(self, path: str) -> int | None:
        if path == _OWN_LIMIT or path.startswith(_OWN_LIMIT + "/"):
            return None
        return LOGIN_BYTES if path == LOGIN_PATH else self._most


def _watched(receive: Receive, limit: int | None) -> Receive:
    size, complete = 0, False

    async def watched() -> Message:
        nonlocal size, complete
        if complete:  # who asks now waits for the connection to end
            return await receive()
        try:
            message = await asyncio.wait_for(receive(), STALL_SECONDS)
        except TimeoutError:
            detail = f"nothing of the body has come for {STALL_SECONDS:g} s"
            raise HTTPException(408, detail, {"Connection": "close"}) from None
        complete = not message.get("more_body", False)
        size += len(message.get("body", b""))
        if limit is not None and size > limit:
            raise HTTPException(413, _detail(f"more than {limit}", limit), {"Connection": "close"})
        return message

    return watched


def _detail(given: str, limit: int) -> str:
    return f"given {given} bytes, accepted at most {limit}"
