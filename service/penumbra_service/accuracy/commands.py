"""`penumbra merge`, as the command line wants it. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Final

from penumbra_scene.exits import Exit

from penumbra_service.commands import Command, CommandError

_MERGE: Final = """\
Take renders of one scene with different seeds together: the mean of all their samples, and its variance.

Renders are weighted by their samples, pixel by pixel; counts add up, and what makes one error bar untrustworthy makes
the merged one so. Files with a seed in common are refused, and so are files of different scenes or windows.

  penumbra render scene.json --seed 1 --out a && penumbra render scene.json --seed 2 --out b
  penumbra merge a/result.exr b/result.exr -o both.exr
"""


def _configure_merge(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", type=Path, nargs="+", metavar="EXR", help="result.exr of each render")
    parser.add_argument("-o", "--out", type=Path, metavar="EXR", required=True, help="the merged file")
    parser.add_argument("--json", action="store_true", help="for programs")


def _merge(arguments: argparse.Namespace) -> int:
    from penumbra_service.accuracy.merge import MergeError, in_words, merge_files
    from penumbra_service.images.exr_read import NotARenderError

    try:
        merged = merge_files(arguments.files, arguments.out)
    except (MergeError, NotARenderError) as error:
        raise CommandError(str(error)) from error
    except OSError as error:
        raise CommandError(f"cannot merge: {error}") from error
    if arguments.json:
        print(json.dumps(dataclasses.asdict(merged), default=str, indent=1))
    else:
        print(in_words(merged))
    return Exit.OK


MERGE: Final = Command("take renders with different seeds together", _MERGE, _configure_merge, _merge)
