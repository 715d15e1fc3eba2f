"""`penumbra devices`: OpenCL devices, of this machine or of a service."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Final

from penumbra_scene.exits import Exit

from penumbra_client.cli.options import connect

if TYPE_CHECKING:
    from penumbra_scene.job import DeviceStatus

SUMMARY: Final = "list the OpenCL devices of this machine, or of a service"
DESCRIPTION: Final = """\
List OpenCL devices: of this machine, or, with --server, those that a service has. The first word of a line is
the id that --device and PENUMBRA_DEVICES take.

  penumbra devices
  penumbra devices --server http://127.0.0.1:8484
  penumbra devices --json
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--server", metavar="URL", help="ask this service instead of this machine")
    parser.add_argument("--json", action="store_true", help="print all that is known of them as JSON")


def run(arguments: argparse.Namespace) -> int:
    """List. The exit status is 7 where there is none."""
    if arguments.server:
        with connect(arguments) as client:
            page = client.devices()
    else:
        from penumbra_client.local import find_engine

        page = find_engine("devices").devices()
    if arguments.json:
        print(page.model_dump_json(indent=1))
    else:
        for device in page.items:
            print(_line(device))
    if page.items:
        return Exit.OK
    print(
        "penumbra: there is no OpenCL device; PoCL makes one of the CPU: pip install 'penumbra-render[cpu]'",
        file=sys.stderr,
    )
    return Exit.DEVICE


def _line(device: DeviceStatus) -> str:
    memory = f"{device.memory_bytes / 2**30:.1f} GiB"
    what = f"{device.kind:4} {device.compute_units:4} units  {memory:>10}"
    return f"{device.id:12} {what}  {device.name} ({device.version})"
