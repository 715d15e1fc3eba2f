"""`penumbra cancel`, `penumbra pause` and `penumbra resume`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_server, connect


@dataclass(frozen=True)
class _Steer:
    """One verb that changes a job's state."""

    verb: str
    SUMMARY: str
    DESCRIPTION: str

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's arguments."""
        parser.add_argument("job", metavar="JOB", nargs="+", help="ids of jobs")
        add_server(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Do it to every job, and print the states that they are in then."""
        with connect(arguments) as client:
            for job_id in arguments.job:
                job = getattr(client, self.verb)(job_id)
                print(f"{job.id} {job.state.value}")
        return Exit.OK


CANCEL: Final = _Steer(
    "cancel",
    "end a job",
    "End jobs. What is in flight on a device takes a second or two to end.\n\n  penumbra cancel 01J8...\n",
)
PAUSE: Final = _Steer(
    "pause",
    "let a job rest",
    "Let jobs rest; they keep what they have, and others get the devices.\n\n  penumbra pause 01J8...\n",
)
RESUME: Final = _Steer(
    "resume", "let a paused job go on", "Let paused jobs go on.\n\n  penumbra resume 01J8...\n"
)
