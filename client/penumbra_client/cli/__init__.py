"""The command line `penumbra`.

Commands of the client live beside this file, one module a command; those that need the service's packages are
found by the entry points `penumbra.commands`. Only the module of the command that is asked for is imported.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NoReturn, Protocol

from penumbra_scene.exits import Exit

if TYPE_CHECKING:  # what is installed is read only where a command needs it
    from importlib.metadata import EntryPoint

ENTRY_POINTS: Final = "penumbra.commands"

_DESCRIPTION: Final = """\
Penumbra renders scenes by distributed ray tracing and says how wrong the pictures are.

  penumbra serve                                keep a service up on 127.0.0.1:8484
  penumbra submit scene.json --wait --out out   send it a scene, watch, fetch the results
  penumbra render scene.json --out out          the same in this process, without a service
"""

_EPILOG: Final = """\
environment:
  PENUMBRA_SERVER    address of the service (default http://127.0.0.1:8484)
  PENUMBRA_API_KEY   key for a service that wants one

exit status:
  0 done  1 a mistake of Penumbra's own  2 usage  3 invalid scene  4 no service answers  5 the job failed
  6 the job was cancelled  7 device trouble  8 the service refused  130 stopped by Ctrl-C
  143 stopped by SIGTERM

`penumbra COMMAND --help` explains a command with examples.
"""


class Command(Protocol):
    """What a command is: a module of this folder, or an object that an entry point names."""

    SUMMARY: str
    """One line for `penumbra --help`."""
    DESCRIPTION: str
    """Paragraphs and examples for `penumbra COMMAND --help`."""

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's arguments."""

    def run(self, arguments: argparse.Namespace) -> int:
        """Do it, and return the exit status."""


BUILT_IN: Final = (
    "submit",
    "watch",
    "fetch",
    "render",
    "quote",
    "validate",
    "devices",
    "jobs",
    "cancel",
    "pause",
    "resume",
)
_SHARED_MODULE: Final = {"cancel": "steer", "pause": "steer", "resume": "steer"}
"""Commands that one module makes."""


def _built_in(name: str) -> Command:
    module: Any = import_module(f"penumbra_client.cli.{_SHARED_MODULE.get(name, name)}")
    command: Command = getattr(module, name.upper()) if name in _SHARED_MODULE else module
    return command


def _plugged_in(name: str) -> EntryPoint | None:
    """The command of that name that a package adds."""
    from penumbra_client.plugins import entry_point

    return entry_point(ENTRY_POINTS, name)


def _all_plugged_in() -> dict[str, EntryPoint]:
    from penumbra_client.plugins import entry_points

    return {point.name: point for point in entry_points(ENTRY_POINTS)}


def _load(point: EntryPoint) -> Command | None:
    """The command, or None where the extra that it needs is not installed."""
    try:
        command: Command = point.load()
    except ImportError:
        return None
    return command


class _Version(argparse.Action):
    """Prints the version, which is looked up only then."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from penumbra_client.plugins import version

        print(f"penumbra {version()}")
        parser.exit()


def _add(subparsers: Any, name: str, command: Command) -> None:
    parser = subparsers.add_parser(
        name,
        help=command.SUMMARY,
        description=command.DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.configure(parser)
    parser.set_defaults(run=command.run)


def make_parser(wanted: str | None) -> argparse.ArgumentParser:
    """A parser that knows the `wanted` command, or, where it is None or unknown, all of them."""
    parser = argparse.ArgumentParser(
        prog="penumbra",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version)
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, title="commands")
    if wanted in BUILT_IN:
        _add(subparsers, wanted, _built_in(wanted))
        return parser
    point = None if wanted is None else _plugged_in(wanted)
    points = _all_plugged_in() if point is None else {point.name: point}
    for name, found in points.items():
        command = _load(found)
        if command is not None:
            _add(subparsers, name, command)
    for name in BUILT_IN if point is None else ():
        _add(subparsers, name, _built_in(name))
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status. Errors become one message on standard error."""
    words = list(sys.argv[1:] if argv is None else argv)
    wanted = words[0] if words and not words[0].startswith("-") else None
    if wanted is not None and wanted not in BUILT_IN:
        missing = _missing_extra(wanted)
        if missing:
            print(missing, file=sys.stderr)
            return Exit.USAGE
    arguments = make_parser(wanted).parse_args(words)
    try:
        return int(arguments.run(arguments))
    except KeyboardInterrupt:
        print("penumbra: interrupted", file=sys.stderr)
        return Exit.INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; keep Python from complaining once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.OK
    except Exception as error:
        code = getattr(error, "exit_code", None)
        if code is None:
            raise
        print(f"penumbra: {error}", file=sys.stderr)
        return int(code)


def program() -> NoReturn:
    """The program `penumbra`: main, and the end at once. To take an interpreter apart that holds libraries for numbers and
    images takes some 50 ms, which whoever waits for a picture would wait for too."""
    signal.signal(signal.SIGTERM, _leave)
    code = main()
    if any(not thread.daemon and thread is not threading.main_thread() for thread in threading.enumerate()):
        sys.exit(code)  # which waits for them
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _leave(number: int, frame: FrameType | None) -> None:
    """As with Ctrl-C, what is under way cleans up behind it. (Services, workers and schedulers have ways of their own.)"""
    raise SystemExit(Exit.TERMINATED)


def _missing_extra(name: str) -> str | None:
    """Why a command that exists cannot be used here, in words."""
    point = _plugged_in(name)
    if point is None or _load(point) is not None:
        return None
    from penumbra_client.local import NEEDED

    return f"penumbra: `penumbra {name}` {NEEDED}"
