"""From a row of the ledger to what the API says of a job."""

from __future__ import annotations

from typing import Any

from penumbra_scene.job import JobLinks, JobRequest, JobStatus, Progress, ProgressEvent

from penumbra_service.store.jobs import JobRow

_LIVE = frozenset(Progress.model_fields)


def initial_progress(request: JobRequest) -> dict[str, Any]:
    """What is known of a job before it starts, in the shape of JobStatus."""
    scene = request.resolved_scene()
    return {
        "width": scene.film.width,
        "height": scene.film.height,
        "sampler": scene.sampler.type,
        "stop": scene.stop.model_dump(mode="json"),
        "samples_planned": scene.stop.samples,
    }


def job_links(job_id: str) -> JobLinks:
    """Paths of all that belongs to a job."""
    base = f"/v1/jobs/{job_id}"
    return JobLinks(
        self=base,
        exr=f"{base}/result.exr",
        thumbnail=f"{base}/thumbnail.png",
        heatmap=f"{base}/heatmap.png",
        receipt=f"{base}/receipt.json",
        events=f"{base}/events",
        page=f"/jobs/{job_id}",
    )


def job_status(row: JobRow, *, curve: bool = False) -> JobStatus:
    """The job as the API shows it; with `curve`, also how its error fell so far, which lists leave out."""
    return JobStatus.model_validate(
        {
            **{key: value for key, value in row.progress.items() if curve or key != "curve"},
            "id": row.id,
            "name": row.name,
            "state": row.state,
            "priority": row.priority,
            "created": row.created,
            "started": row.started,
            "finished": row.finished,
            "stop_reason": row.reason,
            "links": job_links(row.id),
        }
    )


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
