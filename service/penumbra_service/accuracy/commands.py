"""`penumbra merge` and `penumbra compare`, as the command line wants them. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from penumbra_scene import limits
from penumbra_scene.exits import Exit

from penumbra_service.commands import Command, CommandError, frame_time

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


_COMPARE: Final = """\
Render one scene with several samplers, each with 16, 32, 64, 128 and 256 samples a pixel, and measure the error against a
long reference: which reaches which error in how many seconds. The reference is kept, and found again.

Writes compare.json, compare.csv, curves.png (error against seconds, both logarithmic, with fitted slopes) and
pictures.png (all settings side by side in equal time). Plots need the extra `plots`.

  penumbra compare scene.json --samplers independent,jittered,sobol --out compared
  penumbra compare scene.json --adaptive off,on --size 160x120
  penumbra compare scene.json --samples 64,256,1024 --reference 65536 --no-plots
"""
SAMPLERS: Final = ("regular", "random", "independent", "stratified", "jittered", "sobol", "blue_noise")


def _configure_compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (JSON)")
    parser.add_argument(
        "--samplers",
        type=_words(*SAMPLERS),
        metavar="NAMES",
        default=("regular", "random", "independent", "stratified", "jittered", "sobol"),
        help="with commas between them (default: all but blue_noise)",
    )
    parser.add_argument(
        "--adaptive",
        type=_words("off", "on"),
        metavar="off,on",
        default=("off",),
        help="spread samples evenly (off), by error (on), or both (default: off)",
    )
    parser.add_argument(
        "--samples",
        type=_counts,
        metavar="N,N",
        default=None,
        help="samples a pixel (default 16,32,64,128,256)",
    )
    parser.add_argument(
        "--reference",
        type=_reference,
        metavar="N",
        default=None,
        help="samples a pixel of the reference (default: 16 times the most)",
    )
    parser.add_argument(
        "--size", type=_size, metavar="WxH", help="picture size in pixels (default: the scene's)"
    )
    parser.add_argument(
        "--time", type=frame_time, default=0.0, metavar="S", help="of the frame, seconds (default 0)"
    )
    parser.add_argument("--device", metavar="IDS", default="", help="OpenCL devices, commas between them")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", default=Path("compared"), help="where the results go"
    )
    parser.add_argument("--no-plots", action="store_true", help="numbers alone, without matplotlib")


def _words(*accepted: str) -> Callable[[str], tuple[str, ...]]:
    def parse(text: str) -> tuple[str, ...]:
        given = tuple(word.strip() for word in text.split(",") if word.strip())
        wrong = [word for word in given if word not in accepted]
        if wrong or not given:
            raise argparse.ArgumentTypeError(f"{text!r} given, accepted: {', '.join(accepted)}")
        return tuple(dict.fromkeys(given))

    return parse


def _counts(text: str) -> tuple[int, ...]:
    return tuple(sorted({_number(word, text, 1, limits.MAX_SAMPLES) for word in text.split(",")}))


def _reference(text: str) -> int:
    """Two samples at least: one has no variance to take off."""
    return _number(text, text, 2, limits.MAX_SAMPLES)


def _number(word: str, text: str, least: int, most: int) -> int:
    word = word.strip()
    if not (word.isdecimal() and len(word) < 20 and least <= int(word) <= most):
        raise argparse.ArgumentTypeError(f"{text!r} given, accepted: whole numbers from {least} to {most}")
    return int(word)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    try:
        size = _number(width, text, 1, limits.MAX_RESOLUTION), _number(height, text, 1, limits.MAX_RESOLUTION)
    except argparse.ArgumentTypeError:
        size = (0, 0)
    if not 0 < size[0] * size[1] <= limits.MAX_PIXELS:
        accepted = f"WIDTHxHEIGHT, such as 320x240, sides to {limits.MAX_RESOLUTION}, {limits.MAX_PIXELS} pixels in all"
        raise argparse.ArgumentTypeError(f"{text!r} given, accepted: {accepted}")
    return size


def _compare(arguments: argparse.Namespace) -> int:
    from penumbra_scene.errors import ProblemError

    from penumbra_service.accuracy.comparing import Wanted, compare_file, in_words
    from penumbra_service.accuracy.plots import NoPlotsError, demand_matplotlib
    from penumbra_service.engine.task import RunFailedError

    wanted = Wanted(
        samplers=arguments.samplers,
        adaptive=tuple(word == "on" for word in arguments.adaptive),
        samples=arguments.samples,
        reference=arguments.reference,
        size=arguments.size,
        time=arguments.time,
        devices=arguments.device,
        plots=not arguments.no_plots,
    )
    try:
        if wanted.plots:
            demand_matplotlib()
        found = compare_file(
            arguments.scene, wanted, arguments.out, lambda text: print(text, file=sys.stderr, flush=True)
        )
    except NoPlotsError as error:
        raise CommandError(str(error)) from error
    except ProblemError as error:
        raise CommandError(str(error), Exit.INVALID) from error
    except RunFailedError as error:
        raise CommandError(str(error), Exit.FAILED) from error
    except OSError as error:
        named = error.filename is not None and Path(error.filename) == arguments.scene
        raise CommandError(f"cannot compare: {error}", Exit.INVALID if named else Exit.USAGE) from error
    print(in_words(found, arguments.out))
    return Exit.OK


COMPARE: Final = Command("plot the error of samplers against seconds", _COMPARE, _configure_compare, _compare)
