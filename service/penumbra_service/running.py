"""Between the service and whoever renders: a task, how to stop it, how it ended."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

from penumbra_scene.errors import Problem
from penumbra_scene.job import DeviceStatus, JobRequest, JobState, StopReason
from penumbra_scene.quote import Quote
from penumbra_scene.receipt import Receipt


class Halt(StrEnum):
    """Why a runner is asked to stop early."""

    CANCEL = "cancel"
    PAUSE = "pause"
    YIELD = "yield"
    """A more urgent job waits."""
    SHUTDOWN = "shutdown"


class Control:
    """How a runner learns that it shall stop, or that a job has become more or less urgent. Any thread may ask;
    CANCEL outweighs the other reasons."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reason: Halt | None = None
        self._told: list[Callable[[Halt], None]] = []
        self._priority: int | None = None
        self._told_priority: list[Callable[[int], None]] = []

    def halt(self, reason: Halt) -> None:
        """Ask for a stop."""
        with self._lock:
            if self._reason is not None and reason is not Halt.CANCEL:
                return
            self._reason = reason
            told = list(self._told)
        for tell in told:
            tell(reason)

    def prioritize(self, priority: int) -> None:
        """The job has another priority from now on."""
        with self._lock:
            if priority == self._priority:
                return
            self._priority = priority
            told = list(self._told_priority)
        for tell in told:
            tell(priority)

    def when_prioritized(self, tell: Callable[[int], None]) -> None:
        """Have `tell` called with every new priority, at once if there was one; in the thread that tells it."""
        with self._lock:
            self._told_priority.append(tell)
            priority = self._priority
        if priority is not None:
            tell(priority)

    def when_halted(self, tell: Callable[[Halt], None]) -> None:
        """Have `tell` called with every reason, at once if there is one already; in the thread that asks."""
        with self._lock:
            self._told.append(tell)
            reason = self._reason
        if reason is not None:
            tell(reason)

    @property
    def reason(self) -> Halt | None:
        """The weightiest reason so far."""
        return self._reason


@dataclass(frozen=True)
class EndedFrame:
    """A frame that needs no more work."""

    failed: bool
    seconds: float
    """Of tracing."""
    device_seconds: float
    samples: float
    """A pixel."""


class FrameBook(Protocol):
    """Where a runner writes down how the frames of a job stand. Any thread."""

    def ended(self) -> Mapping[int, EndedFrame]:
        """The frames that earlier runs of the job have ended."""

    def report(self, frame: int, state: JobState, news: Mapping[str, Any]) -> None:
        """A frame has moved; `news` are fields of penumbra_scene.job.Progress."""

    def show(self, frame: int) -> None:
        """There are a new thumbnail and noise map in the frame's folder."""

    def end(self, frame: int, outcome: Outcome) -> None:
        """A frame has ended; its results lie in its folder. Raises OSError where they cannot be kept."""


@dataclass(frozen=True)
class Task:
    """A job for a runner."""

    job_id: str
    request: JobRequest
    folder: Path
    """The job's own: snapshots from before may lie in it; results are left in it under the names of
    `results`."""
    priority: int
    created: datetime
    started: datetime
    control: Control
    report: Callable[[JobState, Mapping[str, Any]], None]
    """Called with a state and fields of penumbra_scene.job.Progress (or `devices`) whenever there is news."""
    show: Callable[[], None]
    """Called when there are a new thumbnail and noise map in the folder, or a contact sheet."""
    frames: FrameBook
    """Of a job that has several."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended. Neither: it was halted, and a snapshot lies in the folder."""

    stop_reason: StopReason | None = None
    problem: Problem | None = None
    receipt: Receipt | None = None
    """Of a picture that is there."""

    @property
    def final(self) -> bool:
        """Whether the job has ended with it."""
        return self.stop_reason is not None or self.problem is not None


class Runner(Protocol):
    """Renders one job at a time on the devices that it owns."""

    def start(self) -> None:
        """Gets ready; devices may still be starting when it returns."""

    def stop(self) -> None:
        """Ends every process that it started."""

    def run(self, task: Task) -> Outcome:
        """Blocks until the job has ended or `task.control` asked for a stop. Goes on from a snapshot, if
        any."""

    def quote(self, request: JobRequest, folder: Path) -> Quote:
        """Renders a pilot ahead of all jobs; `folder` is for its files, and the caller removes it. Blocks.

        Raises ProblemError.
        """

    def devices(self) -> list[DeviceStatus]:
        """Every device as it stands."""

    @property
    def problem(self) -> str | None:
        """Why nothing can be rendered, if so."""
