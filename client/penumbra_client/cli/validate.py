"""`penumbra validate`: check a scene without rendering it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import connect

if TYPE_CHECKING:
    from penumbra_scene.job import Finding

SUMMARY: Final = "check a scene without rendering it"
DESCRIPTION: Final = """\
Check a scene: every error is told with its place (a JSON pointer), what was given and what is accepted.
Without --server it is checked here, but for the contents of the files that it names; with --server the
service reads those too.

  penumbra validate scene.json
  penumbra validate scene.json --server http://127.0.0.1:8484
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (JSON), or - for standard input")
    parser.add_argument("--server", metavar="URL", help="let this service check it")


def run(arguments: argparse.Namespace) -> int:
    """Check."""
    from penumbra_client.errors import told_of_file
    from penumbra_client.scenefile import read_scene

    document, folder = read_scene(arguments.scene)
    if arguments.server:
        with connect(arguments) as client, told_of_file():
            warnings = client.validate(document, folder).warnings
    else:
        warnings = _check_here(document, folder)
    for warning in warnings:
        print(f"warning: at {warning.pointer or 'the top'}: {warning.message}")
    print(f"{arguments.scene} is a valid scene")
    return Exit.OK


def _check_here(document: dict[str, Any], folder: Path) -> tuple[Finding, ...]:
    from penumbra_scene.check import check_scene
    from penumbra_scene.errors import ProblemError
    from penumbra_scene.job import Finding
    from penumbra_scene.parse import scene_from_json

    from penumbra_client.errors import RefusedError
    from penumbra_client.scenefile import named_files, resolve_file

    try:
        scene = scene_from_json(document, allow_files=True)
    except ProblemError as error:
        raise RefusedError(error.problem) from None
    for pointer, name in named_files(document):
        resolve_file(folder, name, pointer)
    found = check_scene(scene, allow_files=True)
    return tuple(Finding(pointer=f.pointer, message=f.message) for f in found if f.warning)
