"""A job's life: what can happen in which state, and what cannot."""

from __future__ import annotations

import pytest
from penumbra_scene.job import JobState
from penumbra_service.jobs.life import (
    Action,
    CancelAsked,
    DeviceCrashed,
    IllegalMoveError,
    Life,
    PauseAsked,
    Picked,
    ResumeAsked,
    SceneReady,
    ServiceRestarted,
    StopReached,
    WentWrong,
    Written,
    step,
)

EVENTS = (
    Picked(),
    SceneReady(),
    PauseAsked(),
    ResumeAsked(),
    CancelAsked(),
    StopReached(),
    Written(),
    DeviceCrashed("abort"),
    WentWrong("disk full"),
    ServiceRestarted(),
)


def _walk(*events):  # type: ignore[no-untyped-def]
    life, actions = Life(), []
    for event in events:
        life, more = step(life, event)
        actions += more
    return life, actions


def test_the_plain_way():
    life, actions = _walk(Picked(), SceneReady(), StopReached(), Written())
    assert life.state is JobState.DONE
    assert actions == [Action.START, Action.STOP_FEEDING, Action.WRITE, Action.CLEAN]


def test_pause_keeps_a_snapshot_and_resume_queues_again():
    life, actions = _walk(Picked(), SceneReady(), PauseAsked())
    assert life.state is JobState.PAUSED
    assert actions[-2:] == [Action.STOP_FEEDING, Action.SNAPSHOT]
    life, _ = step(life, ResumeAsked())
    assert life.state is JobState.QUEUED


@pytest.mark.parametrize("state", [s for s in JobState if not s.ended])
def test_every_open_job_can_be_cancelled(state):  # type: ignore[no-untyped-def]
    life, actions = step(Life(state), CancelAsked())
    assert life.state is JobState.CANCELLED
    assert actions[-1] is Action.CLEAN


def test_crashes_are_counted_over_restarts_and_pauses():
    life, actions = _walk(Picked(), DeviceCrashed("a"), ServiceRestarted(), Picked(), DeviceCrashed("b"))
    life, _ = step(life, PauseAsked())
    life, _ = step(life, ResumeAsked())
    life, _ = step(life, Picked())
    life, actions = step(life, DeviceCrashed("c"))
    assert (life.state, life.crashes) == (JobState.COMPILING, 3)
    assert actions == (Action.REISSUE,)


@pytest.mark.parametrize("state", list(JobState))
def test_a_restart_queues_what_was_running_and_nothing_else(state):  # type: ignore[no-untyped-def]
    after, actions = step(Life(state), ServiceRestarted())
    running = (JobState.COMPILING, JobState.RENDERING, JobState.FINISHING)
    assert after.state is (JobState.QUEUED if state in running else state)
    assert actions == ()


@pytest.mark.parametrize("state", [s for s in JobState if s.ended])
@pytest.mark.parametrize("event", EVENTS, ids=lambda e: type(e).__name__)
def test_nothing_happens_to_a_job_that_has_ended(state, event):  # type: ignore[no-untyped-def]
    try:
        after, actions = step(Life(state), event)
    except IllegalMoveError:
        return
    assert after == Life(state)
    assert actions == ()


@pytest.mark.parametrize("state", list(JobState))
@pytest.mark.parametrize("event", EVENTS, ids=lambda e: type(e).__name__)
def test_every_state_answers_every_event_and_only_failures_have_reasons(state, event):  # type: ignore[no-untyped-def]
    try:
        after, _ = step(Life(state), event)
    except IllegalMoveError:
        return
    assert (after.reason is not None) == (after.state is JobState.FAILED and state is not JobState.FAILED)
