"""`penumbra submit`: send a scene to a service."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_scene, add_server, connect, settings

if TYPE_CHECKING:
    from penumbra_scene.job import JobStatus

    from penumbra_client.client import Client

SUMMARY: Final = "send a scene to a service; --wait watches it, --out fetches the results"
DESCRIPTION: Final = """\
Send a scene to a service, and print the job's id.

Meshes and images that the scene names by file are uploaded first; files are relative to the scene's folder.

  penumbra submit scene.json                             print the job's id and return
  penumbra submit scene.json --wait --out out            wait, then fetch EXR, thumbnail, heat map and receipt
  penumbra submit scene.json --error 2% --seconds 60     as good as 2 % or one minute, whichever comes first
  penumbra submit scene.json --frames 1-24 --fps 24      a picture for each frame
  job=$(penumbra submit scene.json) && penumbra watch $job
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_scene(parser)
    add_server(parser)
    parser.add_argument("--wait", action="store_true", help="watch the job until it has ended")
    parser.add_argument("--out", metavar="FOLDER", help="fetch the results into this folder (implies --wait)")
    parser.add_argument("--priority", type=int, metavar="P", help="-100 to 100; higher ones go first")
    parser.add_argument(
        "--idempotency-key",
        metavar="KEY",
        help="submitting twice with one key makes one job (default: a fresh one)",
    )
    parser.add_argument("--json", action="store_true", help="print the job as JSON instead of its id")
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def run(arguments: argparse.Namespace) -> int:
    """Submit, and follow the job as far as asked."""
    from penumbra_client.errors import told_of_file
    from penumbra_client.scenefile import read_scene

    document, folder = read_scene(arguments.scene)
    with connect(arguments) as client:
        with told_of_file():
            job = client.submit(
                document,
                folder,
                idempotency_key=arguments.idempotency_key,
                priority=arguments.priority,
                **settings(arguments, document),
            )
        if not (arguments.wait or arguments.out):
            print(job.model_dump_json(indent=1) if arguments.json else job.id)
            return Exit.OK
        return _follow(client, job, arguments)


def _follow(client: Client, job: JobStatus, arguments: argparse.Namespace) -> int:
    from penumbra_client.cli.progress import ProgressView
    from penumbra_client.cli.report import print_fetched

    print(f"job {job.id}: {client.server}{job.links.page}", file=sys.stderr, flush=True)
    with ProgressView(arguments.quiet) as view:
        job = client.wait(job.id, view)
    paths = client.fetch(job.id, arguments.out) if arguments.out else {}
    if arguments.json:
        print(job.model_dump_json(indent=1))
    else:
        print_fetched(job, paths)
    return Exit.OK
