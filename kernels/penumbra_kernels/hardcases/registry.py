"""All hard cases that the installed packages bring, and running them one by one so that none can spoil the others."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Final

from penumbra_kernels.hardcases.case import HardCase, Measure, Outcome, SkipCase, Status, Workbench

if TYPE_CHECKING:
    from penumbra_kernels.device import Device

DOMAINS: Final = (
    "geometry",
    "leaving",
    "motion",
    "materials",
    "lights",
    "energy",
    "sampling",
    "film",
    "pictures",
)
"""Modules of this package that hold `CASES`."""
ENTRY_POINTS: Final = "penumbra.hardcases"
"""Where other packages name theirs: a tuple of HardCase."""


def cases() -> tuple[HardCase, ...]:
    """The catalogue, by number. Packages whose dependencies are missing are left out."""
    found = [case for name in DOMAINS for case in import_module(f"{__package__}.{name}").CASES]
    for point in metadata.entry_points(group=ENTRY_POINTS):
        try:
            found.extend(point.load())
        except ImportError:
            continue
    return tuple(sorted(found, key=lambda case: case.number))


def select(words: Iterable[str], known: Iterable[HardCase]) -> tuple[HardCase, ...]:
    """The cases that the words name, by number or name. Raises KeyError with the word that names none."""
    known = tuple(known)
    by_word = {str(case.number): case for case in known} | {case.name: case for case in known}
    return tuple(by_word[word] for word in words)


def run_case(case: HardCase, bench: Workbench) -> Outcome:
    """Run one case; whatever it raises becomes its outcome."""
    started = time.perf_counter()
    measures: list[Measure] = []
    status: Status = "passed"
    message = ""
    try:
        measures.extend(case(bench))
        if not measures:
            status, message = "crashed", "measured nothing"
        elif not all(measure.passed for measure in measures):
            status = "failed"
    except SkipCase as reason:
        status, message = "skipped", str(reason)
    except Exception as error:
        status, message = "crashed", f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - started
    return Outcome(case, bench.device.info.id, status, tuple(measures), seconds, message)


def run_cases(device: Device, wanted: Iterable[HardCase], *, full: bool = False) -> Iterator[Outcome]:
    """Outcomes, one as soon as its case is done."""
    bench = Workbench(device, full=full)
    for case in wanted:
        yield run_case(case, bench)


def certify(device: Device) -> list[Outcome]:
    """Run the whole catalogue in its fast setting. The device is fit for work where `passed` says so."""
    return list(run_cases(device, cases()))


def passed(outcomes: Iterable[Outcome]) -> bool:
    """Whether nothing failed or crashed; what was skipped does not count against a device."""
    return all(outcome.status in ("passed", "skipped") for outcome in outcomes)
