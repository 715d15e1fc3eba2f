"""What the command line asks of a renderer in its own process; whoever has one registers it as an entry
point.

The service's package does, so that `penumbra render` and `penumbra devices` work where it is installed, and
the client needs none of what it needs.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:  # devices start before the models of scenes are imported
    from penumbra_scene.job import DevicePage, JobRequest, ProgressEvent
    from penumbra_scene.quote import Quote
    from penumbra_scene.receipt import Receipt

ENTRY_POINTS: Final = "penumbra.engines"
NEEDED: Final = (
    "needs the service's packages, which are not installed: pip install 'penumbra-render[service,cpu]'"
)


class Engine(Protocol):
    """Renders on this machine, without a service. Errors carry an `exit_code`."""

    def devices(self) -> DevicePage:
        """The OpenCL devices of this machine."""

    def ahead(self, devices: str) -> AbstractContextManager[None]:
        """Have devices come up while the scene is read; `devices` as for `render`, which is called within."""

    def render(
        self,
        request: JobRequest,
        folder: Path,
        out: Path,
        devices: str,
        report: Callable[[ProgressEvent], None],
        *,
        anew: bool = False,
    ) -> tuple[Receipt, ...]:
        """Render a job whose files lie under `folder`, and leave its results in `out` under the client's
        names; the receipts of its pictures, one a frame where there are several. Frames that an earlier call has left
        there are kept, unless `anew`.

        `devices` are ids with commas between them, or "" for all. Blocks; reports as it goes.
        """

    def quote(self, request: JobRequest, folder: Path, devices: str) -> Quote:
        """What that would cost, without rendering it."""


def find_engine(command: str) -> Engine:
    """The engine that is installed. Raises ClientError where there is none."""
    from penumbra_client.plugins import entry_points

    for point in entry_points(ENTRY_POINTS):
        try:
            engine: Engine = point.load()
        except ImportError:
            continue
        return engine
    from penumbra_client.errors import ClientError

    raise ClientError(f"`penumbra {command}` {NEEDED}")
