"""`penumbra watch`: follow a job."""

from __future__ import annotations

import argparse
from typing import Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_server, connect

SUMMARY: Final = "follow a job until it has ended"
DESCRIPTION: Final = """\
Follow a job until it has ended. The exit status tells how: 0 done, 5 failed, 6 cancelled.

  penumbra watch 01J8...             a progress bar
  penumbra watch 01J8... --json      one JSON object a line for every step, for programs
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("job", metavar="JOB", help="a job's id")
    add_server(parser)
    parser.add_argument("--json", action="store_true", help="print every event as one line of JSON")
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def run(arguments: argparse.Namespace) -> int:
    """Watch it."""
    from penumbra_scene.job import ProgressEvent

    from penumbra_client.cli.progress import ProgressView
    from penumbra_client.cli.report import print_fetched

    def as_json(event: ProgressEvent) -> None:
        print(event.model_dump_json(), flush=True)

    with connect(arguments) as client, ProgressView(arguments.quiet or arguments.json) as view:
        job = client.wait(arguments.job, as_json if arguments.json else view)
    if not arguments.json:
        print_fetched(job, {})
    return Exit.OK
