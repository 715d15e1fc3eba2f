"""Puts scenes and assets where the workers of a farm can fetch them."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Final

from penumbra_service.engine.dask.wire import Contents, publish
from penumbra_service.engine.protocol import RenderSpec
from penumbra_service.store.contents import ContentStore
from penumbra_service.store.room import is_full

log = logging.getLogger(__name__)

SPACE_SECONDS: Final = 5.0
"""Wait before a disk that was full is tried again."""
AGAIN_SECONDS: Final = 3600.0
"""What was published so long ago is looked after once more, so that it does not count as unused."""


class Publisher:
    """Of one event loop. `url`: of the ContentStore."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._store = ContentStore(url)
        self._published: dict[str, tuple[float, asyncio.Task[Contents]]] = {}

    async def contents_of(self, spec: RenderSpec) -> Contents:
        """Where workers find a spec's scene; it is there when this returns. A full disk is waited for. Raises OSError,
        NotPortableError."""
        while True:
            try:
                return await self._try(spec)
            except OSError as error:
                if not is_full(error):
                    raise
                log.warning("%s: the scene is published when there is room", error)
            await asyncio.sleep(SPACE_SECONDS)

    async def _try(self, spec: RenderSpec) -> Contents:
        now = time.monotonic()
        found = self._published.get(_name(spec))
        if found is None or now - found[0] > AGAIN_SECONDS or _failed(found[1]):
            recent = {k: v for k, v in self._published.items() if now - v[0] <= AGAIN_SECONDS}
            work = asyncio.to_thread(publish, spec, self._store, self._url)
            found = (now, asyncio.create_task(work))
            self._published = {**recent, _name(spec): found}
        return await asyncio.shield(found[1])

    def forget(self, spec: RenderSpec) -> None:
        """A worker did not get it: it is looked after before the next lease."""
        self._published.pop(_name(spec), None)


def _name(spec: RenderSpec) -> str:
    return f"{spec.key} {spec.scene_path}"


def _failed(task: asyncio.Task[Contents]) -> bool:
    return task.done() and (task.cancelled() or task.exception() is not None)
