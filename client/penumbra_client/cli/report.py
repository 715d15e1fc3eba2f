"""What a finished render comes to, in a few lines on standard output."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from penumbra_scene.job import Interval, JobStatus, StopReason
from penumbra_scene.receipt import AdaptiveReport, Receipt

from penumbra_client.cli.progress import count, duration, percent
from penumbra_client.results import FRAMES, OF_SEQUENCE, RESULTS


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
    spent = f"{count(job.samples_done)} samples a pixel in {duration(job.seconds)}"
    if job.frames is not None:
        spent = f"{job.frames.done} of {job.frames.total} frames, {spent}"
    print(f"job {job.id}: {spent}, relative error {error}{_ended(job.stop_reason)}")
    if job.shortfall is not None:
        print(f"warning: {job.shortfall.message}")
    _print_paths(paths)


def print_receipt(receipt: Receipt, folder: Path) -> None:
    """The same of a render in this process."""
    error = error_text(receipt.error.relative_error, receipt.error.relative_error_interval)
    spent = f"{count(receipt.samples)} samples a pixel in {duration(receipt.stages.trace.seconds)} of tracing"
    print(f"{receipt.name}: {spent}, relative error {error}{_ended(receipt.stop_reason)}")
    if receipt.adaptive is not None:
        print(f"adaptive: {_adaptive_text(receipt.adaptive)}")
    for warning in receipt.warnings:
        print(f"warning: {warning}")
    _print_paths({name: folder / file for name, file in RESULTS.items() if (folder / file).exists()})


def print_frames(receipts: Sequence[Receipt], folder: Path, as_json: bool, begun: datetime) -> None:
    """The same of a sequence of frames; with `as_json` a list of the receipts. Those from before `begun` were kept."""
    kept = sum(receipt.created < begun for receipt in receipts)
    if kept:
        print(
            f"{kept} of {len(receipts)} frames were there already; --force renders them anew", file=sys.stderr
        )
    if as_json:
        print(f"[{','.join(receipt.model_dump_json() for receipt in receipts)}]")
        return
    for receipt in receipts:
        error = percent(receipt.error.relative_error)
        spent = duration(receipt.stages.trace.seconds)
        print(
            f"frame {receipt.frame}: {count(receipt.samples)} samples a pixel in {spent}, relative error {error}"
        )
    files = {name: folder / file for name, file in OF_SEQUENCE.items() if (folder / file).exists()}
    _print_paths({"frames": folder / FRAMES, **files})


def _ended(reason: StopReason | None) -> str:
    """Why the render ended."""
    return "" if reason is None else f"; ended by {reason.value.replace('_', ' ')}"


def _adaptive_text(report: AdaptiveReport) -> str:
    most, least = report.levels[0].samples, report.levels[-1].samples
    pilot = f"a pilot of {report.pilot_samples} samples in {duration(report.pilot_seconds)}"
    kept = "kept, so that the picture is biased" if report.biased else "dropped"
    paid = "" if report.shadow_rays is None else f", {report.shadow_rays} of the shadow rays"
    return f"by {report.strategy}, {least} to {most} samples a pixel{paid}; {pilot}, {kept}"


def _print_paths(paths: Mapping[str, Path]) -> None:
    for name, path in paths.items():
        print(f"{name:13} {path}")
