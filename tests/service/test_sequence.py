"""Frames of a job in threads, on a renderer that a test steers."""

from __future__ import annotations

import _thread
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from penumbra_scene.errors import make_problem
from penumbra_scene.job import JobState, StopReason
from penumbra_service.running import Control, EndedFrame, Halt, Outcome
from penumbra_service.sequence import MAX_FAILED, FrameSequence, FrameTask, frames_at_once


class Book:
    """Implements running.FrameBook in memory."""

    def __init__(self, ended: Mapping[int, EndedFrame] | None = None) -> None:
        self.before = dict(ended or {})
        self.states: dict[int, JobState] = {}
        self.outcomes: dict[int, Outcome] = {}

    def ended(self) -> Mapping[int, EndedFrame]:
        return self.before

    def report(self, frame: int, state: JobState, news: Mapping[str, Any]) -> None:
        assert not {"devices", "curve"} & news.keys()
        self.states[frame] = state

    def show(self, frame: int) -> None:
        pass

    def end(self, frame: int, outcome: Outcome) -> None:
        self.outcomes[frame] = outcome


DONE = Outcome(StopReason.SAMPLES)


def run(
    frames: tuple[int, ...],
    render: Callable[[FrameTask], Outcome],
    book: Book | None = None,
    control: Control | None = None,
    at_once: int = 2,
) -> tuple[Outcome, Book, list[tuple[JobState, Mapping[str, Any]]]]:
    book = book or Book()
    told: list[tuple[JobState, Mapping[str, Any]]] = []
    sequence = FrameSequence(
        frames, book, control or Control(), render, lambda state, news: told.append((state, news)), at_once
    )
    return sequence.run(), book, told


def test_frames_begin_in_order_and_no_more_than_so_many_at_once() -> None:
    begun: list[int] = []
    running: set[int] = set()
    most = 0
    lock = threading.Lock()

    def render(task: FrameTask) -> Outcome:
        nonlocal most
        with lock:
            begun.append(task.number)
            running.add(task.number)
            most = max(most, len(running))
        time.sleep(0.01)
        with lock:
            running.remove(task.number)
        return DONE

    outcome, book, _ = run(tuple(range(3, 15)), render, at_once=3)
    assert outcome.stop_reason is StopReason.SAMPLES
    assert sorted(begun) == list(range(3, 15))
    # threads take numbers in order; which of three neighbours gets to the renderer first is chance
    assert all(abs(number - 3 - place) < 3 for place, number in enumerate(begun))
    assert most == 3
    assert set(book.outcomes) == set(range(3, 15))


def test_the_job_reports_shares_sums_and_the_newest_error() -> None:
    def render(task: FrameTask) -> Outcome:
        news = {"progress": 0.5, "samples_done": 8.0, "seconds": 2.0, "relative_error": 0.1 * task.number}
        task.report(JobState.RENDERING, {**news, "devices": [f"d{task.number}"], "curve": [1]})
        return DONE

    _, _, told = run((1, 2, 3, 4), render, at_once=1)
    state, last = told[-1]
    assert state is JobState.RENDERING
    assert last["progress"] == 1.0
    assert last["seconds"] == 8.0
    assert last["samples_done"] == 8.0
    assert last["relative_error"] == pytest.approx(0.4)
    assert last["devices"] == ["d1", "d2", "d3", "d4"]
    assert last["frames"] == {"total": 4, "done": 4, "failed": 0}
    shares = [news["progress"] for _, news in told]
    assert shares == sorted(shares)


def test_frames_that_have_ended_stay_so_and_count() -> None:
    begun: list[int] = []

    def render(task: FrameTask) -> Outcome:
        begun.append(task.number)
        task.report(
            JobState.RENDERING, {"progress": 0.5, "seconds": 1.0, "device_seconds": 2.0, "samples_done": 4.0}
        )
        return DONE

    book = Book({1: EndedFrame(False, 5.0, 10.0, 4.0), 2: EndedFrame(False, 7.0, 14.0, 4.0)})
    outcome, _, told = run((1, 2, 3), render, book)
    assert outcome.stop_reason is StopReason.SAMPLES
    assert begun == [3]
    assert told[-1][1]["seconds"] == 13.0
    assert told[-1][1]["device_seconds"] == 26.0
    assert told[-1][1]["frames"] == {"total": 3, "done": 3, "failed": 0}


def test_a_run_with_nothing_left_is_done_at_once() -> None:
    book = Book({1: EndedFrame(False, 5.0, 10.0, 4.0)})
    outcome, _, _ = run((1,), lambda task: pytest.fail("nothing to render"), book)
    assert outcome.stop_reason is StopReason.SAMPLES


@pytest.mark.parametrize("reason", [Halt.PAUSE, Halt.CANCEL])
def test_a_halt_reaches_every_frame_that_runs_and_begins_no_other(reason: Halt) -> None:
    control = Control()
    begun = threading.Barrier(3)
    reasons: list[Halt] = []

    def render(task: FrameTask) -> Outcome:
        stopped = threading.Event()
        task.control.when_halted(lambda why: (reasons.append(why), stopped.set())[0])
        begun.wait(10)
        assert stopped.wait(10)
        return Outcome()

    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(run((1, 2, 3), render, control=control)))
    thread.start()
    begun.wait(10)
    control.halt(reason)
    thread.join(10)
    outcome, book, _ = results[0]
    assert not outcome.final
    assert reasons == [reason, reason]
    assert book.states == {1: JobState.PAUSED, 2: JobState.PAUSED}


def failing(*which: int, kind: str = "job-crash") -> Callable[[FrameTask], Outcome]:
    def render(task: FrameTask) -> Outcome:
        if task.number in which:
            return Outcome(problem=make_problem(kind, "It crashed", 500, f"here: {task.number}"))
        return DONE

    return render


def test_a_failed_frame_stops_no_other_and_fails_the_job_at_its_end() -> None:
    outcome, book, told = run((1, 2, 3, 4), failing(2))
    assert outcome.problem is not None
    assert outcome.problem.detail == "frame 2 failed; 3 of 4 frames are done; frame 2: here: 2"
    assert set(book.outcomes) == {1, 2, 3, 4}
    assert told[-1][1]["frames"] == {"total": 4, "done": 3, "failed": 1}


def test_many_failed_frames_end_the_job() -> None:
    frames = tuple(range(1, 100))
    outcome, book, _ = run(frames, failing(*frames), at_once=1)
    assert outcome.problem is not None
    assert len(book.outcomes) == MAX_FAILED


def test_what_all_frames_would_fail_of_ends_the_job_at_once() -> None:
    frames = tuple(range(1, 100))
    outcome, book, _ = run(frames, failing(1, kind="job-device"), at_once=1)
    assert outcome.problem is not None
    assert list(book.outcomes) == [1]


def test_a_mistake_in_a_frame_is_no_silent_end() -> None:
    def render(task: FrameTask) -> Outcome:
        raise RuntimeError("a mistake")

    with pytest.raises(RuntimeError, match="a mistake"):
        run((1, 2), render)


def test_frames_at_once_follow_the_devices() -> None:
    assert [frames_at_once(n) for n in (0, 1, 2, 10, 10_000)] == [3, 3, 4, 12, 64]


def test_ctrl_c_stops_the_frames_that_run_and_begins_no_others() -> None:
    begun: list[int] = []

    def render(task: FrameTask) -> Outcome:
        begun.append(task.number)
        if len(begun) == 2:
            _thread.interrupt_main()
        deadline = time.monotonic() + 20
        while task.control.reason is None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert task.control.reason is Halt.SHUTDOWN
        return Outcome()

    with pytest.raises(KeyboardInterrupt):
        run(tuple(range(10)), render)
    assert sorted(begun) == [0, 1]
