"""A job's life as a pure state machine: (life, event) -> (life, actions). Whoever calls it does what the
actions say.

    queued -> compiling -> rendering -> finishing -> done
    queued, compiling, rendering -> paused -> queued; any state that has not ended -> cancelled, failed
    compiling, rendering, finishing -> queued when the service starts again
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Final

from penumbra_scene.job import JobState


class Action(Enum):
    """What the caller does after a step, in the order given."""

    START = auto()
    """Run the job, from its snapshot where there is one."""
    STOP_FEEDING = auto()
    """Issue no more leases; results that still come in count."""
    SNAPSHOT = auto()
    """Write what the film holds."""
    DROP = auto()
    """Issue no more leases and forget those under way; keep nothing."""
    REISSUE = auto()
    """Give the lost leases to whoever is there."""
    WRITE = auto()
    """Write the picture, thumbnail and receipt."""
    CLEAN = auto()
    """Remove the work folder."""


@dataclass(frozen=True)
class Picked:
    """The job's turn has come."""


@dataclass(frozen=True)
class SceneReady:
    """A device has compiled the scene and traces."""


@dataclass(frozen=True)
class PauseAsked:
    pass


@dataclass(frozen=True)
class ResumeAsked:
    pass


@dataclass(frozen=True)
class CancelAsked:
    pass


@dataclass(frozen=True)
class StopReached:
    """The stop rule holds."""


@dataclass(frozen=True)
class Written:
    """All results are stored."""


@dataclass(frozen=True)
class DeviceCrashed:
    """A device process died, or hung and was killed, while it worked on this job."""

    reason: str


@dataclass(frozen=True)
class WentWrong:
    """Something that another attempt would not mend: a broken asset, a kernel that does not build, a full
    disk."""

    reason: str


@dataclass(frozen=True)
class ServiceRestarted:
    """The process that ran the job is another one now."""


Event = (
    Picked
    | SceneReady
    | PauseAsked
    | ResumeAsked
    | CancelAsked
    | StopReached
    | Written
    | DeviceCrashed
    | WentWrong
    | ServiceRestarted
)


@dataclass(frozen=True)
class Life:
    """Where a job stands."""

    state: JobState = JobState.QUEUED
    crashes: int = 0
    reason: str | None = None
    """Why it failed."""


class IllegalMoveError(ValueError):
    """The event cannot happen to a job in this state; nothing has changed."""

    def __init__(self, state: JobState, event: Event) -> None:
        super().__init__(f"a job that is {state} cannot take {type(event).__name__}")
        self.state = state
        self.event = event


Step = tuple[Life, tuple[Action, ...]]

_ACTIVE: Final = frozenset({JobState.COMPILING, JobState.RENDERING})
_RUNNING: Final = _ACTIVE | {JobState.FINISHING}

_MOVES: Final[dict[tuple[JobState, type], tuple[JobState, tuple[Action, ...]]]] = {
    (JobState.QUEUED, Picked): (JobState.COMPILING, (Action.START,)),
    (JobState.COMPILING, SceneReady): (JobState.RENDERING, ()),
    (JobState.RENDERING, SceneReady): (JobState.RENDERING, ()),
    (JobState.RENDERING, StopReached): (JobState.FINISHING, (Action.STOP_FEEDING, Action.WRITE)),
    # A snapshot may hold all that is asked for, so that no device compiles anything.
    (JobState.COMPILING, StopReached): (JobState.FINISHING, (Action.STOP_FEEDING, Action.WRITE)),
    (JobState.FINISHING, Written): (JobState.DONE, (Action.CLEAN,)),
    (JobState.QUEUED, PauseAsked): (JobState.PAUSED, ()),
    (JobState.COMPILING, PauseAsked): (JobState.PAUSED, (Action.STOP_FEEDING, Action.SNAPSHOT)),
    (JobState.RENDERING, PauseAsked): (JobState.PAUSED, (Action.STOP_FEEDING, Action.SNAPSHOT)),
    (JobState.PAUSED, PauseAsked): (JobState.PAUSED, ()),
    (JobState.PAUSED, ResumeAsked): (JobState.QUEUED, ()),
    (JobState.QUEUED, ResumeAsked): (JobState.QUEUED, ()),
    (JobState.COMPILING, ResumeAsked): (JobState.COMPILING, ()),
    (JobState.RENDERING, ResumeAsked): (JobState.RENDERING, ()),
    (JobState.QUEUED, CancelAsked): (JobState.CANCELLED, (Action.CLEAN,)),
    (JobState.PAUSED, CancelAsked): (JobState.CANCELLED, (Action.CLEAN,)),
    (JobState.CANCELLED, CancelAsked): (JobState.CANCELLED, ()),
}


def step(life: Life, event: Event) -> Step:
    """What an event does to a job. Raises IllegalMoveError where it cannot happen."""
    if isinstance(event, ServiceRestarted):
        return _restarted(life)
    if isinstance(event, DeviceCrashed):
        return _crashed(life)
    if isinstance(event, WentWrong):
        return _went_wrong(life, event)
    if isinstance(event, CancelAsked) and life.state in _RUNNING:
        return replace(life, state=JobState.CANCELLED), (Action.DROP, Action.CLEAN)
    move = _MOVES.get((life.state, type(event)))
    if move is None:
        raise IllegalMoveError(life.state, event)
    state, actions = move
    return replace(life, state=state), actions


def _restarted(life: Life) -> Step:
    if life.state in _RUNNING:
        return replace(life, state=JobState.QUEUED), ()
    return life, ()


def _crashed(life: Life) -> Step:
    """Crashes are counted over the job's whole life; what they mean for it says blame.py."""
    if life.state not in _ACTIVE:
        return life, ()
    return replace(life, crashes=life.crashes + 1), (Action.REISSUE,)


def _went_wrong(life: Life, event: WentWrong) -> Step:
    if life.state.ended:
        raise IllegalMoveError(life.state, event)
    running = life.state in _RUNNING
    actions = (Action.DROP, Action.CLEAN) if running else (Action.CLEAN,)
    return replace(life, state=JobState.FAILED, reason=event.reason), actions
