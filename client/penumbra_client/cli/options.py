"""Arguments that several commands share, and what they come to."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from penumbra_client.client import Client

SAMPLERS: Final = ("regular", "random", "independent", "stratified", "jittered", "sobol", "blue_noise")

ADAPTIVE: Final = {
    "off": {"strategy": "off"},
    "certified": {"strategy": "error", "mode": "certified"},
    "fast": {"strategy": "error", "mode": "fast"},
    "contrast": {"strategy": "contrast"},
}
"""What --adaptive puts in place of the scene's section."""


def add_server(parser: argparse.ArgumentParser) -> None:
    """Which service."""
    parser.add_argument(
        "--server",
        metavar="URL",
        help="address of the service (default: PENUMBRA_SERVER, or http://127.0.0.1:8484); "
        "a key is taken from PENUMBRA_API_KEY",
    )


def connect(arguments: argparse.Namespace) -> Client:
    """The client that the arguments ask for."""
    from penumbra_client.client import Client

    return Client(arguments.server)


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Which scene, and what takes the place of its own settings."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (JSON), or - for standard input")
    group = parser.add_argument_group("settings that take the place of the scene's own")
    group.add_argument("--samples", type=_count, metavar="N", help="stop at N samples a pixel")
    group.add_argument("--seconds", type=_positive, metavar="S", help="stop after S seconds of tracing")
    group.add_argument(
        "--error", type=_error, metavar="E", help="stop at this relative error, such as 0.02 or 2%%"
    )
    group.add_argument("--sampler", choices=SAMPLERS, help="how samples are placed in every domain")
    group.add_argument("--seed", type=_seed, metavar="K", help="seed of the random numbers, 0 to 2^64-1")
    group.add_argument(
        "--adaptive",
        choices=tuple(ADAPTIVE),
        help="more samples where they are needed: by the error (certified: unbiased; fast: keeps the pilot's "
        "samples), or by neighbours' contrast",
    )
    group.add_argument("--size", type=_size, metavar="WxH", help="picture size in pixels, such as 320x240")
    which = group.add_mutually_exclusive_group()
    which.add_argument("--frame", type=_seed, metavar="F", help="render the scene at the time F / fps")
    which.add_argument(
        "--frames", metavar="LIST", help="render several frames, such as 1-24, 1-240x2 or 1,5,10-20"
    )
    group.add_argument("--fps", type=_positive, metavar="R", help="frames a second (default 24)")
    group.add_argument("--name", help="name of the job (default: the scene's)")
    group.add_argument(
        "--measure-effects",
        action="store_true",
        default=None,
        help="say in the receipt what each effect cost, in seconds and in noise; takes a few seconds more",
    )


def settings(arguments: argparse.Namespace, document: dict[str, Any]) -> dict[str, Any]:
    """The keys of a job request beside the scene; a section that is touched is the scene's, changed."""
    found: dict[str, Any] = {"name": arguments.name, "fps": arguments.fps}
    found["measure_effects"] = arguments.measure_effects
    if arguments.frame is not None:
        found["frames"] = str(arguments.frame)
    elif arguments.frames is not None:
        found["frames"] = arguments.frames
    stop = {"samples": arguments.samples, "seconds": arguments.seconds, "relative_error": arguments.error}
    if any(value is not None for value in stop.values()):
        confidence = _section(document, "stop").get("confidence")
        found["stop"] = _given({**stop, "confidence": confidence})
    if arguments.adaptive is not None:
        found["adaptive"] = ADAPTIVE[arguments.adaptive]
    seed = None if arguments.seed is None else str(arguments.seed)
    if arguments.sampler is not None or seed is not None:
        found["sampler"] = {
            **_section(document, "sampler"),
            **_given({"type": arguments.sampler, "seed": seed}),
        }
    if arguments.size is not None:
        width, height = arguments.size
        found["film"] = {**_section(document, "film"), "width": width, "height": height}
    return _given(found)


def _section(document: dict[str, Any], key: str) -> dict[str, Any]:
    section = document.get(key)
    return section if isinstance(section, dict) else {}


def _given(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _count(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} given, a whole number above 0 accepted")
    return int(text)


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) >= 2**64:
        raise argparse.ArgumentTypeError(f"{text!r} given, a whole number from 0 to {2**64 - 1} accepted")
    return int(text)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (0 < value < math.inf):
        raise argparse.ArgumentTypeError(f"{text!r} given, a number above 0 accepted")
    return value


def _error(text: str) -> float:
    percent = text.endswith("%")
    value = _positive(text.removesuffix("%")) / (100 if percent else 1)
    if value > 1:
        raise argparse.ArgumentTypeError(f"{text!r} given, an error of at most 1 (100%) accepted")
    return value


def _size(text: str) -> tuple[int, int]:
    sides = text.split("x")
    if len(sides) != 2 or not all(side.isdecimal() and int(side) for side in sides):
        raise argparse.ArgumentTypeError(f"{text!r} given, WIDTHxHEIGHT accepted, such as 320x240")
    return int(sides[0]), int(sides[1])
