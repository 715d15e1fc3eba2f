"""What a finished job comes to, in a few lines on standard output."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from penumbra_scene.job import Interval, JobStatus

from penumbra_client.cli.progress import duration, percent


def error_text(error: float | None, interval: Interval | None) -> str:
    """A relative error with its interval."""
    text = percent(error)
    if error is None or interval is None or interval.high is None:
        return text
    share = f"{100 * interval.confidence:.3g} %"
    return f"{text} ({share} interval {percent(interval.low)} to {percent(interval.high)})"


def print_fetched(job: JobStatus, paths: Mapping[str, Path]) -> None:
    """The achieved error, and where the files are."""
    spent = f"{job.samples_done:.4g} samples a pixel in {duration(job.seconds)}"
    error = error_text(job.relative_error, job.relative_error_interval)
    print(f"job {job.id}: {spent}, relative error {error}")
    for name, path in paths.items():
        print(f"{name:10} {path}")
