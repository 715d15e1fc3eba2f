"""`penumbra quote`: what accuracy will cost in time, before the work."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import add_scene, connect, settings

if TYPE_CHECKING:
    from penumbra_scene.quote import Quote

SUMMARY: Final = "say what accuracy will cost in time"
DESCRIPTION: Final = """\
Render a pilot of some two seconds and say what each relative error will take on the devices at hand: samples,
seconds, and the interval that they should lie in. Compiling comes on top where the program is not cached yet; the
quote says how long it took, and the job that follows need not do it again.

  penumbra quote scene.json                                     on this machine
  penumbra quote scene.json --error 1%                          with a row for an error of 1 %
  penumbra quote scene.json --server http://127.0.0.1:8484      on the devices of a service
  penumbra quote scene.json --json | jq '.table[] | [.relative_error, .seconds]'
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_scene(parser)
    parser.add_argument(
        "--server", "--url", metavar="URL", help="ask this service (default: this machine's own devices)"
    )
    parser.add_argument(
        "--device", metavar="IDS", default="", help="OpenCL devices, commas between them (default: all)"
    )
    parser.add_argument("--json", action="store_true", help="print the quote as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Quote."""
    from penumbra_client.errors import told_of_file
    from penumbra_client.scenefile import read_scene

    document, folder = read_scene(arguments.scene)
    given = settings(arguments, document)
    if arguments.server:
        with connect(arguments) as client, told_of_file():
            quote = client.quote(document, folder, **given)
    else:
        quote = _quote_here(document, folder, given, arguments.device)
    if arguments.json:
        print(quote.model_dump_json(indent=1))
    else:
        from penumbra_client.cli.quote_view import print_quote

        print_quote(quote)
    return Exit.OK


def _quote_here(document: dict[str, Any], folder: Any, given: dict[str, Any], devices: str) -> Quote:
    from penumbra_client.cli.render import checked_request
    from penumbra_client.local import find_engine
    from penumbra_client.scenefile import named_files, resolve_file

    engine = find_engine("quote")
    request = checked_request(document, given)
    for pointer, name in named_files(document):
        resolve_file(folder, name, pointer)
    return engine.quote(request, folder, devices)
