"""From a row of the ledger to what the API says of a job."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from penumbra_scene.frames import parse_frames
from penumbra_scene.job import (
    FrameCounts,
    FrameLinks,
    FrameStatus,
    JobRequest,
    JobState,
    JobStatus,
    Progress,
    ProgressEvent,
)
from pydantic_core import to_json

from penumbra_service.results import CONTACT_SHEET, HEATMAP, MOVIE, RECEIPT, RESULT, THUMBNAIL
from penumbra_service.store.frames import FrameRow, NoSuchFrameError
from penumbra_service.store.jobs import JobRow

_LIVE = frozenset({*Progress.model_fields, "frames"})
_SEQUENCE = "sequence"
"""Key of a row's progress under which it keeps which frames were asked for: the request may have megabytes."""
_HIDDEN = frozenset({_SEQUENCE})
_HIDDEN_IN_LISTS = _HIDDEN | {"curve"}


def initial_progress(request: JobRequest) -> dict[str, Any]:
    """What is known of a job before it starts, in the shape of JobStatus."""
    scene = request.resolved_scene()
    sequence = request.sequence
    several = {
        _SEQUENCE: {"frames": request.frames, "fps": request.fps},
        "frames": FrameCounts(total=len(sequence)).model_dump(),
    }
    return {
        **(several if sequence else {}),
        "width": scene.film.width,
        "height": scene.film.height,
        "sampler": scene.sampler.type,
        "stop": scene.stop.model_dump(mode="json"),
        "samples_planned": scene.stop.samples,
    }


def _job_links(job_id: str, several: bool) -> dict[str, str | None]:
    """Fields of JobLinks; `several`: of a job with several frames."""
    base = f"/v1/jobs/{job_id}"
    return {
        "self": base,
        **_picture_links(base),
        "events": f"{base}/events",
        "page": f"/jobs/{job_id}",
        "frames": f"{base}/frames" if several else None,
        "contact_sheet": f"{base}/{CONTACT_SHEET}" if several else None,
        "movie": f"{base}/{MOVIE}" if several else None,
    }


def _picture_links(base: str) -> dict[str, str]:
    return {
        "exr": f"{base}/{RESULT}",
        "thumbnail": f"{base}/{THUMBNAIL}",
        "heatmap": f"{base}/{HEATMAP}",
        "receipt": f"{base}/{RECEIPT}",
    }


def job_status(row: JobRow, *, curve: bool = False) -> JobStatus:
    """The job as the API shows it; with `curve`, also how its error fell so far, which lists leave out."""
    return JobStatus.model_validate(_fields(row, curve))


def job_page(rows: Sequence[JobRow], following: str | None) -> bytes:
    """A page of the list of jobs, a JobPage in JSON. Rows hold what was checked when it was written: to make models of
    them once more would take longer than all the rest."""
    items = [{**_UNKNOWN, **_fields(row, False)} for row in rows]
    return to_json({"items": items, "next": following})


_UNKNOWN: Final = {
    name: field.get_default() for name, field in JobStatus.model_fields.items() if not field.is_required()
}
"""What JobStatus says of a field that a row does not have."""


def _fields(row: JobRow, curve: bool) -> dict[str, Any]:
    hidden = _HIDDEN if curve else _HIDDEN_IN_LISTS
    return {
        **{key: value for key, value in row.progress.items() if key not in hidden},
        "id": row.id,
        "name": row.name,
        "state": row.state,
        "priority": row.priority,
        "created": row.created,
        "started": row.started,
        "finished": row.finished,
        "stop_reason": row.reason,
        "links": _job_links(row.id, _SEQUENCE in row.progress),
    }


def progress_event(row: JobRow) -> ProgressEvent:
    """The job as an event shows it."""
    live = {key: value for key, value in row.progress.items() if key in _LIVE}
    return ProgressEvent.model_validate(
        {
            **live,
            "id": row.id,
            "state": row.state,
            "stop_reason": row.reason,
            "problem": row.progress.get("problem"),
        }
    )


def frame_numbers(row: JobRow) -> tuple[int, ...]:
    """The frames of a job that has several; empty for any other."""
    sequence = row.progress.get(_SEQUENCE)
    return () if sequence is None else parse_frames(sequence["frames"])


def frame_status(job: JobRow, number: int, row: FrameRow | None) -> FrameStatus:
    """A frame as the API shows it; `row` is None where it was not begun. Raises NoSuchFrameError."""
    if number not in frame_numbers(job):
        raise no_such_frame(job, number)
    base = f"/v1/jobs/{job.id}/frames/{number}"
    known: dict[str, Any] = {}
    if row is not None:
        known = {
            **row.progress,
            "stop_reason": row.reason,
            "started": row.started,
            "finished": row.finished,
        }
    return FrameStatus.model_validate(
        {
            **known,
            "number": number,
            "time": number / job.progress[_SEQUENCE]["fps"],
            "state": _frame_state(JobState(job.state), row),
            "links": FrameLinks(self=base, **_picture_links(base)),
        }
    )


def no_such_frame(job: JobRow, number: int) -> NoSuchFrameError:
    """The error that says which frames there are."""
    sequence = job.progress.get(_SEQUENCE)
    has = "makes a single picture: see its result.exr" if sequence is None else f"has {sequence['frames']}"
    return NoSuchFrameError(f"job {job.id} has no frame {number}: it {has}")


def _frame_state(job: JobState, row: FrameRow | None) -> JobState:
    """A frame that has not ended is at most as far as its job."""
    if row is not None and JobState(row.state).ended:
        return JobState(row.state)
    if job.ended:
        return JobState.CANCELLED
    if job in (JobState.QUEUED, JobState.PAUSED):
        return job
    if row is None or row.state == JobState.PAUSED:
        return JobState.QUEUED
    return JobState(row.state)
