"""`penumbra warm`: build programs before anybody waits for them, in a compiler process for each device."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from penumbra_scene.exits import Exit

from penumbra_service.commands import Command, CommandError

_WARM: Final = """\
Build programs into the cache, so that no job has to wait for a compiler.

  penumbra warm                        the generic ones, with which any scene begins at once, and the example scenes'
  penumbra warm --sampler blue_noise   the same under this sampler; several: commas between them
  penumbra warm a.json b.json          those that these scenes need
  penumbra warm --device pocl:0        for one device (default: all of this machine)
  penumbra warm --json                 a line of JSON for each program
"""


def _configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE", help="scene files (JSON)")
    parser.add_argument(
        "--device", metavar="IDS", default="", help="OpenCL devices, commas between them (default: all)"
    )
    parser.add_argument(
        "--sampler", metavar="NAMES", default="", help="samplers of the usual programs (default: sobol)"
    )
    parser.add_argument("--json", action="store_true", help="for programs")


def _devices(wanted: str) -> list[str]:
    from penumbra_service.engine.local import NoDeviceError, list_devices

    try:
        have = [device.id for device in list_devices()]
    except NoDeviceError as error:
        raise CommandError(str(error), Exit.DEVICE) from error
    ids = [part.strip() for part in wanted.split(",") if part.strip()] or have
    missing = sorted(set(ids) - set(have))
    if missing or not ids:
        told = ", ".join(have) or "none"
        raise CommandError(f"no OpenCL device {', '.join(missing)}; this machine has: {told}", Exit.DEVICE)
    return ids


def _samplers(wanted: str) -> list[str]:
    from penumbra_kernels.warm import SAMPLERS

    names = [part.strip() for part in wanted.split(",") if part.strip()]
    unknown = sorted(set(names) - set(SAMPLERS))
    if unknown:
        raise CommandError(f"no sampler {', '.join(unknown)}; there are: {', '.join(SAMPLERS)}", Exit.INVALID)
    return names


def _programs(paths: Sequence[Path], samplers: Sequence[str]) -> list[tuple[str, dict[str, int]]]:
    from penumbra_kernels.warm import programs_of, usual_programs
    from penumbra_scene.errors import ProblemError
    from penumbra_scene.parse import parse_scene

    if not paths:
        return list(usual_programs(samplers))
    if samplers:
        raise CommandError("--sampler is for the usual programs; a scene names its own", Exit.INVALID)
    scenes = []
    for path in paths:
        try:
            scenes.append((path.name, parse_scene(path.read_bytes(), allow_files=True)))
        except OSError as error:
            raise CommandError(f"cannot read {path}: {error.strerror}") from error
        except ProblemError as error:
            raise CommandError(f"{path}: {error}", Exit.INVALID) from error
    return list(programs_of(scenes))


def _run(arguments: argparse.Namespace) -> int:
    from penumbra_kernels import cache
    from penumbra_kernels.compiler import Compiler

    cache.made(cache.PROGRAMS)
    programs = _programs(arguments.scenes, _samplers(arguments.sampler))
    refused = 0
    for device in _devices(arguments.device):
        compiler = Compiler(device)
        try:
            for number, (name, flags) in enumerate(programs, 1):
                compiler.order(flags)
                built = compiler.answer()
                assert built is not None
                problem = "the compiler's process died" if built.died else built.problem
                refused += problem is not None
                if arguments.json:
                    told = {"device": device, "program": name, "built": built.built, "seconds": built.seconds}
                    print(json.dumps({**told, "problem": problem}), flush=True)
                else:
                    print(_line(device, number, len(programs), name, built.built, built.seconds), flush=True)
                    if problem is not None:
                        print(problem, file=sys.stderr)
        finally:
            compiler.close()
    return Exit.DEVICE if refused else Exit.OK


def _line(device: str, number: int, count: int, name: str, built: bool, seconds: float) -> str:
    how = f"built in {seconds:.2f} s" if built else "in the cache"
    return f"{device}  {number:>2}/{count}  {how:<16}  {name}"


WARM: Final = Command("build programs before they are needed", _WARM, _configure, _run)
