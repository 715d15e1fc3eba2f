"""What a finished render comes to, in a few lines on standard output."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from penumbra_scene.job import Interval, JobStatus
from penumbra_scene.receipt import Receipt

from penumbra_client.cli.progress import duration, percent
from penumbra_client.results import RESULTS


def error_text(error: float | None, interval: Interval | None) -> str:
    """A relative error with its interval."""
    text = percent(error)
    if error is None or interval is None or interval.high is None:
        return text
    share = f"{100 * interval.confidence:.3g} %"
    return f"{text} ({share} interval {percent(interval.low)} to {percent(interval.high)})"


def print_fetched(job: JobStatus, paths: Mapping[str, Path]) -> None:
    """The achieved error of a service's job, and where its files are."""
    error = error_text(job.relative_error, job.relative_error_interval)
    spent = f"{job.samples_done:.4g} samples a pixel in {duration(job.seconds)}"
    print(f"job {job.id}: {spent}, relative error {error}")
    _print_paths(paths)


def print_receipt(receipt: Receipt, folder: Path) -> None:
    """The same of a render in this process."""
    error = error_text(receipt.error.relative_error, receipt.error.relative_error_interval)
    spent = f"{receipt.samples:.4g} samples a pixel in {duration(receipt.stages.trace.seconds)} of tracing"
    print(f"{receipt.name}: {spent}, relative error {error}")
    for warning in receipt.warnings:
        print(f"warning: {warning}")
    _print_paths({name: folder / file for name, file in RESULTS.items() if (folder / file).exists()})


def _print_paths(paths: Mapping[str, Path]) -> None:
    for name, path in paths.items():
        print(f"{name:10} {path}")
