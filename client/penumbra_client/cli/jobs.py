"""`penumbra jobs`: the service's jobs."""

from __future__ import annotations

import argparse
from typing import Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_server, connect

STATES: Final = ("queued", "compiling", "rendering", "paused", "finishing", "done", "failed", "cancelled")
SUMMARY: Final = "list a service's jobs, or show one"
DESCRIPTION: Final = """\
List jobs, newest first, or show one of them with all that is known.

  penumbra jobs                                   the newest 20
  penumbra jobs --state rendering --state queued  those that are at work or waiting
  penumbra jobs 01J8...                           one job as JSON
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("job", metavar="JOB", nargs="?", help="a job's id: show it as JSON")
    add_server(parser)
    parser.add_argument(
        "--state", action="append", choices=STATES, help="only these; may be given several times"
    )
    parser.add_argument("--limit", type=int, default=20, metavar="N", help="how many at most (default 20)")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")


def run(arguments: argparse.Namespace) -> int:
    """List."""
    with connect(arguments) as client:
        if arguments.job:
            print(client.job(arguments.job).model_dump_json(indent=1))
            return Exit.OK
        jobs = list(client.jobs(arguments.state or (), arguments.limit))
    if arguments.json:
        for job in jobs:
            print(job.model_dump_json())
        return Exit.OK
    from penumbra_client.cli.progress import percent

    for job in jobs:
        error = percent(job.relative_error)
        print(f"{job.id}  {job.state.value:10} {100 * job.progress:3.0f} %  error {error:10}  {job.name}")
    return Exit.OK
