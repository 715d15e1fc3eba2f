"""The client: submit scenes, follow jobs, fetch results."""

from __future__ import annotations

import contextlib
import json
import os
import time
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import httpx
from penumbra_scene.job import (
    AssetInfo,
    DevicePage,
    FramePage,
    FrameStatus,
    Health,
    JobPage,
    JobState,
    JobStatus,
    ProgressEvent,
    Validation,
)
from penumbra_scene.quote import Quote

from penumbra_client.errors import (
    ClientError,
    JobCancelledError,
    JobFailedError,
    NotFinishedError,
    RefusedError,
    UnreachableError,
    cannot_write,
)
from penumbra_client.http import Connection
from penumbra_client.results import FRAMES, OF_SEQUENCE, RESULTS, frame_folder
from penumbra_client.scenefile import (
    JsonObject,
    content_hash,
    named_files,
    read_scene,
    resolve_file,
    with_assets,
)
from penumbra_client.watch import watch

_TRIES: Final = 3
"""Times that a submission is sent where the connection breaks; its Idempotency-Key keeps it one job."""
_BLOCK: Final = 1 << 20
_UPLOAD_TIMEOUT: Final = httpx.Timeout(300.0, connect=5.0)
"""Seconds: the service decodes an asset before it answers."""
_QUOTE_TIMEOUT: Final = httpx.Timeout(360.0, connect=5.0)
"""Seconds: the service may have to compile, and to finish what its devices are at."""


class Client:
    """A connection to one Penumbra service. Close it, or use it in a `with` statement.

    Every method raises UnreachableError where nothing answers, and RefusedError where the service says no;
    its `problem` tells why, with JSON pointers into the scene.
    """

    def __init__(
        self,
        server: str | None = None,
        api_key: str | None = None,
        *,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        """`server` defaults to PENUMBRA_SERVER or http://127.0.0.1:8484, `api_key` to PENUMBRA_API_KEY."""
        self._connection = Connection(server, api_key, transport)
        self._sleep: Callable[[float], None] = time.sleep

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the sockets back."""
        self._connection.close()

    @property
    def server(self) -> str:
        """The service's address."""
        return self._connection.server

    def health(self) -> Health:
        """How the service is."""
        return self._connection.document(Health, "GET", "/health")

    def devices(self) -> DevicePage:
        """The service's OpenCL devices."""
        return self._connection.document(DevicePage, "GET", "/v1/devices")

    def validate(
        self, scene: str | Path | JsonObject, folder: Path | None = None, **settings: Any
    ) -> Validation:
        """Have the service check a scene without rendering it; arguments as for `submit`."""
        request = self._request(scene, folder, settings)
        return self._connection.document(Validation, "POST", "/v1/validate", **_as_json(request))

    def quote(self, scene: str | Path | JsonObject, folder: Path | None = None, **settings: Any) -> Quote:
        """What a scene would cost on the service's devices: relative errors with samples and seconds.

        Arguments as for `submit`. Takes some two seconds, and as long as the service has to compile.
        """
        request = self._request(scene, folder, settings)
        return self._connection.document(
            Quote, "POST", "/v1/quotes", timeout=_QUOTE_TIMEOUT, **_as_json(request)
        )

    def submit(
        self,
        scene: str | Path | JsonObject,
        folder: Path | None = None,
        *,
        idempotency_key: str | None = None,
        **settings: Any,
    ) -> JobStatus:
        """Submit a scene: a JSON file's path, or a document whose files lie under `folder`.

        Files that it names are uploaded first, where the service does not have them yet. `settings` are the
        other keys of a job request: name, priority, frames, fps, film, sampler, integrator, stop. Submitting
        twice with one `idempotency_key` makes one job.
        """
        request = self._request(scene, folder, settings)
        headers = {"Idempotency-Key": idempotency_key or str(uuid.uuid4())}
        for tries_left in reversed(range(_TRIES)):
            try:
                return self._connection.document(JobStatus, "POST", "/v1/jobs", **_as_json(request, headers))
            except UnreachableError:
                if not tries_left:
                    raise
                self._sleep(1.0)
        raise AssertionError("the last try returns or raises")

    def _request(
        self, scene: str | Path | JsonObject, folder: Path | None, settings: JsonObject
    ) -> JsonObject:
        document, beside = (scene, folder) if isinstance(scene, dict) else read_scene(str(scene))
        hashes: dict[str, str] = {}
        for pointer, name in named_files(document):
            if beside is None:
                raise ClientError(f"{pointer} names the file {name!r}; tell which `folder` it is relative to")
            if name not in hashes:
                hashes[name] = self.upload(resolve_file(beside, name, pointer))
        given = {key: value for key, value in settings.items() if value is not None}
        return {"scene": with_assets(document, hashes), **given}

    def upload(self, path: Path) -> str:
        """Upload a mesh or an image unless the service has it already; returns its name, `sha256:...`."""
        name = content_hash(path)
        if not self._has_asset(name):
            with path.open("rb") as file:
                info = self._connection.document(
                    AssetInfo, "PUT", f"/v1/assets/{name}", content=_blocks(file), timeout=_UPLOAD_TIMEOUT
                )
            if info.asset != name:
                raise ClientError(
                    f"{path} changed while it was uploaded: it was {name}, the service got {info.asset}"
                )
        return name

    def _has_asset(self, name: str) -> bool:
        try:
            self._connection.send("HEAD", f"/v1/assets/{name}")
        except RefusedError as refused:
            if refused.problem.status == httpx.codes.NOT_FOUND:
                return False
            raise
        return True

    def job(self, job_id: str) -> JobStatus:
        """How a job stands."""
        return self._connection.document(JobStatus, "GET", _path(job_id))

    def jobs(self, states: Collection[str] = (), limit: int | None = None) -> Iterator[JobStatus]:
        """Jobs, newest first; in these states only, where any are given; `limit` of them at most."""
        cursor: str | None = None
        left = limit
        while left is None or left > 0:
            query: dict[str, Any] = {"limit": min(left or 100, 100)}
            if states:
                query["state"] = list(states)
            if cursor is not None:
                query["cursor"] = cursor
            page = self._connection.document(JobPage, "GET", "/v1/jobs", params=query)
            yield from page.items
            left = None if left is None else left - len(page.items)
            cursor = page.next
            if cursor is None:
                return

    def cancel(self, job_id: str) -> JobStatus:
        """End a job; what it has rendered so far can still be fetched where there is any."""
        return self._steer(job_id, "cancel")

    def pause(self, job_id: str) -> JobStatus:
        """Let a job rest; it keeps what it has."""
        return self._steer(job_id, "pause")

    def resume(self, job_id: str) -> JobStatus:
        """Let a paused job go on."""
        return self._steer(job_id, "resume")

    def _steer(self, job_id: str, verb: str) -> JobStatus:
        return self._connection.document(JobStatus, "POST", f"{_path(job_id)}/{verb}")

    def watch(self, job_id: str, patience: float = 60.0) -> Iterator[ProgressEvent]:
        """A job's progress until it has ended, over broken connections too.

        Raises UnreachableError once the service has been away for some `patience` seconds.
        """
        return watch(self._connection, f"{_path(job_id)}/events", patience, self._sleep)

    def wait(self, job_id: str, report: Callable[[ProgressEvent], None] | None = None) -> JobStatus:
        """Wait until a job is done. Raises JobFailedError, with the reason, and JobCancelledError."""
        for event in self.watch(job_id):
            if report is not None:
                report(event)
        return finished(self.job(job_id))

    def frames(self, job_id: str) -> Iterator[FrameStatus]:
        """The frames of a job that has several, by number; none of any other job."""
        after: int | None = -1
        while after is not None:
            page = self._connection.document(
                FramePage, "GET", f"{_path(job_id)}/frames", params={"after": after, "limit": 1000}
            )
            yield from page.items
            after = page.next

    def fetch(
        self, job_id: str, folder: str | Path, only: Collection[str] = tuple(RESULTS)
    ) -> dict[str, Path]:
        """Download results into a folder, which is made if need be: any of exr, thumbnail, heatmap, receipt.

        Returns the paths by these names. A file appears whole or not at all. Of a job with several frames the frames
        that are done are fetched into folders of their own, `frames/0012/result.exr`, the contact sheet and, where
        the service makes one, the preview movie. Raises NotFinishedError where the job has no such result yet.
        """
        job = self.job(job_id)
        target = Path(folder)
        try:
            target.mkdir(parents=True, exist_ok=True)
            if job.frames is not None:
                return self._fetch_frames(job, target, only)
            return {
                name: self._download(job, getattr(job.links, name), target / RESULTS[name]) for name in only
            }
        except OSError as error:
            raise cannot_write(target, error) from error

    def _fetch_frames(self, job: JobStatus, target: Path, only: Collection[str]) -> dict[str, Path]:
        done = [frame for frame in self.frames(job.id) if frame.state == JobState.DONE]
        if not done:
            raise NotFinishedError(f"job {job.id} is {job.state} and has no finished frame yet")
        for frame in done:
            here = target / frame_folder(frame.number)
            here.mkdir(parents=True, exist_ok=True)
            for name in only:
                self._download(job, getattr(frame.links, name), here / RESULTS[name])
        found = {"frames": target / FRAMES}
        for name, file in OF_SEQUENCE.items():
            with contextlib.suppress(NotFinishedError):
                found[name] = self._download(job, getattr(job.links, name), target / file)
        return found

    def _download(self, job: JobStatus, link: str, path: Path) -> Path:
        partial = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            with (
                self._connection.stream("GET", link) as response,
                partial.open("wb") as file,
            ):
                for block in response.iter_bytes():
                    file.write(block)
            partial.replace(path)
        except RefusedError as refused:
            if refused.problem.status != httpx.codes.NOT_FOUND:
                raise
            raise NotFinishedError(f"job {job.id} is {job.state} and has no {path.name} yet") from None
        finally:
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
        return path


def finished(job: JobStatus) -> JobStatus:
    """The job, if it is done; raises what its end was otherwise."""
    if job.state == JobState.FAILED:
        why = f"{job.problem.title}: {job.problem.detail}" if job.problem else "it gives no reason"
        raise JobFailedError(f"job {job.id} failed: {why}")
    if job.state == JobState.CANCELLED:
        raise JobCancelledError(f"job {job.id} was cancelled")
    return job


def _path(job_id: str) -> str:
    if not job_id or not all(c.isalnum() or c in "-_" for c in job_id):
        raise ClientError(f"{job_id!r} is no job id")
    return f"/v1/jobs/{job_id}"


def _as_json(document: JsonObject, headers: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The document as a request's body. NaN is sent as it stands: the service tells where it is."""
    return {
        "content": json.dumps(document, separators=(",", ":")).encode(),
        "headers": {"Content-Type": "application/json", **(headers or {})},
    }


def _blocks(file: Any) -> Iterator[bytes]:
    while block := file.read(_BLOCK):
        yield block
