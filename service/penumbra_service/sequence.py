"""Runs the frames of a job: several at once as lease sources of one engine, in the order of their numbers.

A frame alone would leave devices idle at its end, when its last leases are out, and while its files are written. So
the next ones are under way by then: they get what the earlier ones leave (jobs.dispatch). A frame that fails does not
stop the others, unless all would fail alike; then, and after MAX_FAILED, the job ends.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, Final

from penumbra_scene.errors import TYPE_PREFIX, Problem, make_problem
from penumbra_scene.job import JobState, StopReason

from penumbra_service.log_context import bind, bound_fields
from penumbra_service.running import Control, EndedFrame, FrameBook, Halt, Outcome

MAX_FAILED: Final = 3
"""Frames that may fail until the job does."""
REPORT_SECONDS: Final = 0.25
"""Least time between two reports of the job, and between two of a frame whose state stays."""
FATAL: Final = ("job-device", "job-storage", "job-build")
"""Kinds of problems that every frame would have."""
MOST_AT_ONCE: Final = 64


def frames_at_once(devices: int) -> int:
    """One that most devices work on, one for each device that runs dry, one whose files are written."""
    return min(max(devices, 1) + 2, MOST_AT_ONCE)


@dataclass(frozen=True)
class FrameTask:
    """One frame for `render`."""

    number: int
    control: Control
    report: Callable[[JobState, Mapping[str, Any]], None]
    show: Callable[[], None]


class FrameSequence:
    """Runs the frames of one job that have not ended yet, once."""

    def __init__(
        self,
        frames: tuple[int, ...],
        book: FrameBook,
        control: Control,
        render: Callable[[FrameTask], Outcome],
        report: Callable[[JobState, Mapping[str, Any]], None],
        at_once: int,
        finished: Callable[[int], None] = lambda frame: None,
    ) -> None:
        """`render` blocks, and is called in several threads; `report` is told how the whole job stands; `finished`
        is called with a frame that is done before the book takes its files."""
        self._book = book
        self._control = control
        self._render = render
        self._report = report
        self._at_once = at_once
        self._finished = finished
        ended = book.ended()
        self._waiting = [frame for frame in reversed(frames) if frame not in ended]
        self._progress = JobProgress(frames, ended)
        self._lock = threading.Lock()
        self._running: dict[int, Control] = {}
        self._halted: Halt | None = None
        self._context = bound_fields()
        """Of the log: threads of their own do not inherit it."""
        self._priority: int | None = None
        self._hopeless = False
        self._problems: dict[int, Problem] = {}
        self._crashed: BaseException | None = None

    def run(self) -> Outcome:
        """Blocks until every frame has ended, the job has failed, or `control` asked for a stop."""
        self._control.when_halted(self._halt)
        self._control.when_prioritized(self._prioritize)
        with ThreadPoolExecutor(self._at_once, thread_name_prefix="penumbra-frame") as pool:
            try:
                wait([pool.submit(self._work) for _ in range(self._at_once)])
            except BaseException:  # Ctrl-C: the pool's end waits for its threads
                self._halt(Halt.SHUTDOWN)
                raise
        if self._crashed is not None:
            raise self._crashed
        if not self._progress.complete and not self._hopeless:
            return Outcome()
        self._tell(force=True)
        if self._progress.failed:
            return Outcome(problem=self._problem())
        return Outcome(self._progress.reason)

    def _work(self) -> None:
        """One thread: frame after frame."""
        try:
            while (taken := self._take()) is not None:
                self._run_one(*taken)
        except Exception as error:
            self._crashed = error
            self._halt(Halt.SHUTDOWN)

    def _take(self) -> tuple[int, Control] | None:
        with self._lock:
            if self._halted is not None or not self._waiting:
                return None
            frame, control = self._waiting.pop(), Control()
            if self._priority is not None:
                control.prioritize(self._priority)
            self._running[frame] = control
        return frame, control

    def _run_one(self, frame: int, control: Control) -> None:
        task = FrameTask(
            frame,
            control,
            report=self._reporter(frame),
            show=lambda: self._book.show(frame),
        )
        try:
            with bind(**self._context, frame=frame):
                outcome = self._render(task)
        finally:
            with self._lock:
                self._running.pop(frame)
        if not outcome.final:
            self._book.report(frame, JobState.PAUSED, {})
            return
        if outcome.problem is None:
            self._finished(frame)
        self._book.end(frame, outcome)
        self._note(frame, outcome)
        self._tell(force=True)

    def _reporter(self, frame: int) -> Callable[[JobState, Mapping[str, Any]], None]:
        told: list[tuple[JobState, float]] = []

        def report(state: JobState, news: Mapping[str, Any]) -> None:
            now = time.monotonic()
            if not told or told[-1][0] is not state or now >= told[-1][1] + REPORT_SECONDS:
                told[:] = [(state, now)]
                self._book.report(frame, state, {k: v for k, v in news.items() if k not in OF_JOB})
            with self._lock:
                self._progress.moved(frame, state, news)
            self._tell()

        return report

    def _note(self, frame: int, outcome: Outcome) -> None:
        """A frame has ended."""
        with self._lock:
            self._progress.ended(frame, outcome)
            if outcome.problem is None:
                return
            self._problems[frame] = outcome.problem
            kind = outcome.problem.type.removeprefix(TYPE_PREFIX)
            self._hopeless = kind in FATAL or self._progress.failed >= MAX_FAILED
        if self._hopeless:
            self._halt(Halt.SHUTDOWN)

    def _halt(self, reason: Halt) -> None:
        """Begin no more frames, and stop those that run."""
        with self._lock:
            self._halted = reason
            controls = list(self._running.values())
        for control in controls:
            control.halt(reason)

    def _prioritize(self, priority: int) -> None:
        with self._lock:
            self._priority = priority
            controls = list(self._running.values())
        for control in controls:
            control.prioritize(priority)

    def _tell(self, force: bool = False) -> None:
        with self._lock:
            news = self._progress.news(time.monotonic(), force)
        if news is not None:
            self._report(self._progress.state, news)

    def _problem(self) -> Problem:
        """Why the job failed: the first problem of this run, and which frames had one."""
        failed = ", ".join(str(frame) for frame in sorted(self._progress.failures))
        which = f"frame {failed}" if self._progress.failed == 1 else f"frames {failed}"
        done = f"{self._progress.done} of {self._progress.total} frames are done"
        if not self._problems:
            return make_problem("job-frames", "Frames failed", 500, f"{which} failed; {done}")
        frame, first = min(self._problems.items())
        return first.model_copy(update={"detail": f"{which} failed; {done}; frame {frame}: {first.detail}"})


OF_JOB: Final = frozenset({"devices", "curve"})
"""What a picture reports that is told of the whole job only."""


class JobProgress:
    """How a job of several frames stands, from how they do. Pure; its owner holds a lock."""

    def __init__(self, frames: tuple[int, ...], ended: Mapping[int, EndedFrame]) -> None:
        self.total = len(frames)
        self.failures = {frame for frame, end in ended.items() if end.failed}
        self.done = len(ended) - len(self.failures)
        self.state = JobState.COMPILING
        self.reason = StopReason.SAMPLES
        self._news: dict[int, Mapping[str, Any]] = {}
        self._devices: set[str] = set()
        self._finished: Mapping[str, Any] = {}
        self._seconds = sum(end.seconds for end in ended.values())
        self._device_seconds = sum(end.device_seconds for end in ended.values())
        self._samples = sum(end.samples for end in ended.values() if not end.failed)
        self._told_at = -float("inf")
        self._most = 0.0

    @property
    def failed(self) -> int:
        return len(self.failures)

    @property
    def complete(self) -> bool:
        """Whether every frame has ended."""
        return self.done + self.failed == self.total

    def moved(self, frame: int, state: JobState, news: Mapping[str, Any]) -> None:
        """A frame has reported."""
        self._news[frame] = news
        self._devices.update(news.get("devices", ()))
        if state is JobState.RENDERING:
            self.state = JobState.RENDERING

    def ended(self, frame: int, outcome: Outcome) -> None:
        """A frame needs no more work."""
        news = self._news.pop(frame, {})
        self._seconds += news.get("seconds", 0.0)
        self._device_seconds += news.get("device_seconds", 0.0)
        if outcome.problem is not None:
            self.failures.add(frame)
            return
        self.done += 1
        self._samples += news.get("samples_done", 0.0)
        self._finished = news
        self.reason = outcome.stop_reason or self.reason

    def news(self, now: float, force: bool) -> dict[str, Any] | None:
        """Fields of JobStatus; None where it is too early for them."""
        if not force and now < self._told_at + REPORT_SECONDS:
            return None
        self._told_at = now
        running = self._news.values()
        parts = self.done + self.failed + sum(news.get("progress", 0.0) for news in running)
        self._most = max(self._most, parts / self.total)
        seconds = self._seconds + sum(news.get("seconds", 0.0) for news in running)
        device_seconds = self._device_seconds + sum(news.get("device_seconds", 0.0) for news in running)
        samples = [news.get("samples_done", 0.0) for news in running]
        seen = self.done + len(samples)
        shown = self._finished or next(iter(running), {})
        return {
            "progress": min(self._most, 1.0),
            "samples_done": (self._samples + sum(samples)) / seen if seen else 0.0,
            "seconds": seconds,
            "device_seconds": device_seconds,
            "predicted_seconds": seconds / parts * (self.total - parts) if parts > 0 else None,
            **{name: shown.get(name) for name in _OF_NEWEST},
            "devices": sorted(self._devices),
            "frames": {"total": self.total, "done": self.done, "failed": self.failed},
        }


_OF_NEWEST: Final = ("relmse", "relative_error", "relative_error_interval", "theta")
