"""`penumbra render`: trace a scene in this process, without a service."""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_scene, settings

if TYPE_CHECKING:
    from penumbra_scene.job import JobRequest

    from penumbra_client.local import Engine

SUMMARY: Final = "trace a scene here, without a service"
DESCRIPTION: Final = """\
Trace a scene on this machine's OpenCL devices without a service, and leave EXR, thumbnail, heat map and
receipt in a folder.

  penumbra render scene.json --out out                          as the scene says
  penumbra render scene.json --out out --samples 16 --size 320x240
  penumbra render scene.json --out out --error 1% --seconds 300 as good as 1 %, but in five minutes at most
  penumbra render scene.json --out out --sampler jittered --seed 7
  penumbra render scene.json --out out --frames 1-24 --fps 24   a folder for each frame, and a contact sheet

A render of several frames that was ended early (by Ctrl-C, say) goes on when it is asked for again: frames in the
folder whose receipt is of the same scene, seed and settings are kept.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_scene(parser)
    parser.add_argument("--out", metavar="FOLDER", default="out", help="where the results go (default: out)")
    parser.add_argument(
        "--device", metavar="IDS", default="", help="OpenCL devices, commas between them (default: all)"
    )
    parser.add_argument("--force", action="store_true", help="render frames anew that are there")
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the receipt (of several frames: a list) instead of a few words",
    )
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def run(arguments: argparse.Namespace) -> int:
    """Render."""
    from penumbra_client.local import find_engine

    engine = find_engine("render")
    with engine.ahead(arguments.device):
        return _render(engine, arguments)


def _render(engine: Engine, arguments: argparse.Namespace) -> int:
    from penumbra_client.cli.progress import ProgressView
    from penumbra_client.cli.report import print_frames, print_receipt
    from penumbra_client.errors import cannot_write
    from penumbra_client.scenefile import named_files, read_scene, resolve_file

    document, folder = read_scene(arguments.scene)
    request = checked_request(document, settings(arguments, document))
    for pointer, name in named_files(document):
        resolve_file(folder, name, pointer)
    out, begun = Path(arguments.out), datetime.now(UTC)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with ProgressView(arguments.quiet) as view:
            receipts = engine.render(request, folder, out, arguments.device, view, anew=arguments.force)
    except OSError as error:
        raise cannot_write(out, error) from error
    if request.sequence:
        print_frames(receipts, out, arguments.json, begun)
    elif arguments.json:
        print(receipts[0].model_dump_json(indent=1))
    else:
        print_receipt(receipts[0], out)
    return Exit.OK


def checked_request(document: dict[str, Any], given: dict[str, Any]) -> JobRequest:
    """The job, checked. Raises RefusedError with pointers into the file."""
    from penumbra_scene.errors import ProblemError
    from penumbra_scene.parse import job_from_json

    from penumbra_client.errors import RefusedError, told_of_file

    with told_of_file():
        try:
            return job_from_json({"scene": document, **given}, allow_files=True)
        except ProblemError as error:
            raise RefusedError(error.problem) from None
