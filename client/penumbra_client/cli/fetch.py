"""`penumbra fetch`: download what a job has made."""

from __future__ import annotations

import argparse
from typing import Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_server, connect
from penumbra_client.results import RESULTS

SUMMARY: Final = "download a job's results"
DESCRIPTION: Final = """\
Download a job's results into a folder, and print the files' paths. Of a job with several frames those that are
done come, each into a folder of its own, and the contact sheet.

  penumbra fetch 01J8... --out out                    EXR, thumbnail, heat map and receipt
  penumbra fetch 01J8... --out out --only exr         the EXR alone
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("job", metavar="JOB", help="a job's id")
    add_server(parser)
    parser.add_argument("--out", metavar="FOLDER", default=".", help="where to (default: the current folder)")
    parser.add_argument(
        "--only", action="append", choices=tuple(RESULTS), help="only this result; may be given several times"
    )


def run(arguments: argparse.Namespace) -> int:
    """Fetch."""
    with connect(arguments) as client:
        paths = client.fetch(arguments.job, arguments.out, arguments.only or RESULTS)
    for path in paths.values():
        print(path)
    return Exit.OK
