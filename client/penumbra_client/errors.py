"""What can go wrong between a client and the service, each with the exit code of the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from penumbra_scene.errors import Problem, ProblemError
from penumbra_scene.exits import Exit


class ClientError(Exception):
    """Anything that the client refuses or could not do; its text says what to do next."""

    exit_code = Exit.USAGE


class SceneFileError(ClientError):
    """A scene file, or a file that a scene names, cannot be read or is not JSON."""

    exit_code = Exit.INVALID


class UnreachableError(ClientError):
    """No service answers."""

    exit_code = Exit.UNREACHABLE

    def __init__(self, server: str, why: str) -> None:
        super().__init__(
            f"no Penumbra service answers at {server} ({why}); start one with `penumbra serve`, "
            "or name another with --server or PENUMBRA_SERVER"
        )


class RefusedError(ProblemError, ClientError):
    """The service answered with a problem (RFC 9457); `problem` holds it."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.exit_code = Exit.INVALID if problem.status == 422 or problem.errors else Exit.REFUSED


@contextmanager
def told_of_file() -> Iterator[None]:
    """Has the places in refusals of a job (`/scene/camera/fov`) point into the scene's file (`/camera/fov`)."""
    try:
        yield
    except RefusedError as refused:
        items = tuple(
            item.model_copy(update={"pointer": item.pointer.removeprefix("/scene")})
            if item.pointer == "/scene" or item.pointer.startswith("/scene/")
            else item
            for item in refused.problem.errors
        )
        raise RefusedError(refused.problem.model_copy(update={"errors": items})) from None


class NotFinishedError(ClientError):
    """A result was asked for that is not there yet."""

    exit_code = Exit.REFUSED


class JobFailedError(ClientError):
    """The job ended without a picture."""

    exit_code = Exit.FAILED


class JobCancelledError(ClientError):
    """Somebody cancelled the job."""

    exit_code = Exit.CANCELLED


def cannot_write(path: Path, error: OSError) -> ClientError:
    """A file or folder for results that cannot be written."""
    return ClientError(f"cannot write {path}: {error.strerror or error}")
