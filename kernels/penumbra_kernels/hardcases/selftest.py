"""`penumbra selftest`: the hard cases on this machine's devices, as a table or as JSON."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

from penumbra_scene.exits import Exit

from penumbra_kernels.hardcases.case import HardCase, Measure, Outcome
from penumbra_kernels.hardcases.registry import cases, passed, run_cases, select

FAILED: Final = 1
"""Exit status where a case failed."""


class SelftestError(Exception):
    """The self-test cannot start; its text goes to standard error."""

    exit_code = Exit.USAGE


def relation(measure: Measure) -> str:
    """The measure as a line of text: number, relation, bound."""
    sign = ">=" if measure.at_least else "<="
    return f"{measure.value:.4g} {sign} {measure.bound:.4g}"


def as_dict(outcome: Outcome) -> dict[str, Any]:
    """An outcome for programs."""
    return {
        "number": outcome.case.number,
        "name": outcome.case.name,
        "sentence": outcome.case.sentence,
        "oracle": outcome.case.oracle,
        "algorithm": outcome.case.algorithm,
        "device": outcome.device,
        "status": outcome.status,
        "seconds": round(outcome.seconds, 3),
        "message": outcome.message,
        "measures": [{**asdict(measure), "passed": measure.passed} for measure in outcome.measures],
    }


def _line(outcome: Outcome) -> str:
    worst = outcome.worst
    measured = f"{relation(worst)}  {worst.what}" if worst else outcome.message
    return f"{outcome.case.number:>3} {outcome.case.name:<28} {outcome.status:<8} {measured}"


def _details(outcome: Outcome) -> Iterator[str]:
    for measure in outcome.measures:
        yield f"      {'' if measure.passed else 'FAILED '}{relation(measure)}  {measure.what}"
    if outcome.message and outcome.measures:
        yield f"      {outcome.message}"


def _report(outcome: Outcome, *, details: bool) -> None:
    print(_line(outcome), flush=True)
    if details or outcome.status == "failed":
        for line in _details(outcome):
            print(line, flush=True)


def _wanted(words: list[str] | None) -> tuple[HardCase, ...]:
    known = cases()
    if not words:
        return known
    try:
        return select(words, known)
    except KeyError as error:
        names = ", ".join(f"{case.number} {case.name}" for case in known)
        raise SelftestError(f"there is no hard case {error.args[0]!r}; there are: {names}") from None


def _devices(words: list[str] | None) -> list[str]:
    from penumbra_kernels.device import DeviceError, devices

    have = [info.id for info in devices()]
    if not have:
        raise SelftestError("this machine has no OpenCL device")
    for word in words or ():
        if word not in have:
            raise SelftestError(
                str(DeviceError(f"no OpenCL device {word!r}; this machine has: {', '.join(have)}"))
            )
    return words or have


def _run(arguments: argparse.Namespace) -> int:
    from penumbra_kernels import cache
    from penumbra_kernels.device import Device

    cache.check()
    wanted = _wanted(arguments.case)
    outcomes: list[Outcome] = []
    machines = []
    for device_id in _devices(arguments.device):
        device = Device(device_id)
        machines.append({"id": device.info.id, "name": device.info.name, "driver": device.info.driver})
        if not arguments.json:
            print(f"{device.info.id}: {device.info.name}, driver {device.info.driver}")
        for outcome in run_cases(device, wanted, full=arguments.full):
            outcomes.append(outcome)
            if not arguments.json:
                _report(outcome, details=bool(arguments.case))
    good = passed(outcomes)
    if arguments.json:
        answer = {
            "passed": good,
            "full": arguments.full,
            "devices": machines,
            "outcomes": [as_dict(o) for o in outcomes],
        }
        json.dump(answer, sys.stdout, indent=1)
        print()
    else:
        counts = {
            status: sum(o.status == status for o in outcomes)
            for status in ("passed", "failed", "crashed", "skipped")
        }
        seconds = sum(o.seconds for o in outcomes)
        print(", ".join(f"{n} {status}" for status, n in counts.items() if n) + f" in {seconds:.0f} s")
    return Exit.OK if good else FAILED


def _configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device", action="append", metavar="ID", help="a device to test, may be repeated (default: all)"
    )
    parser.add_argument(
        "--case",
        action="append",
        metavar="CASE",
        help="a case by number or name, may be repeated (default: all)",
    )
    parser.add_argument(
        "--full", action="store_true", help="with the samples of the catalogue: minutes instead of one"
    )
    parser.add_argument("--json", action="store_true", help="for programs: every measured number")


class Selftest:
    """The command, as the command line wants it."""

    SUMMARY: Final = "run the hard cases on this machine's devices"
    DESCRIPTION: Final = """\
Measure on this machine's OpenCL devices what naive ray tracing code gets wrong, and hold each number against its bound.

A table names each case, its worst measured number and the bound; docs/numerics.md explains them. The exit status is 1
where a case failed: such a device, or its driver, should not render.

  penumbra selftest                              every case on every device
  penumbra selftest --device pocl:0 --json       for programs
  penumbra selftest --case shared-edge --full    one case, all of its numbers, the catalogue's counts
"""
    configure = staticmethod(_configure)
    run = staticmethod(_run)


SELFTEST: Final = Selftest()
