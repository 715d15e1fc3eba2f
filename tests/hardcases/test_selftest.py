"""`penumbra selftest`: what it prints, how it ends, and that one broken case spoils no other."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases import HardCase, Measure, Workbench, cases, passed, run_cases, select
from penumbra_kernels.hardcases.case import SkipCase, at_least, at_most
from penumbra_scene.exits import Exit


def _case(number: int, run: object) -> HardCase:
    return HardCase(number, f"case-{number}", "", "", "", run)  # type: ignore[arg-type]


def _selftest(*words: str, module: str = "penumbra_client") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", module, *(["selftest"] if module == "penumbra_client" else []), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)


def test_numbers_and_names_are_unique() -> None:
    known = cases()
    assert len({case.number for case in known}) == len(known)
    assert len({case.name for case in known}) == len(known)
    assert all(case.sentence and case.oracle and case.algorithm for case in known)


def test_a_case_is_found_by_number_and_by_name() -> None:
    assert select(["8", "shared-edge"], cases()) == (
        *select(["far-sphere"], cases()),
        *select(["1"], cases()),
    )
    with pytest.raises(KeyError, match="no-such"):
        select(["no-such"], cases())


def test_nan_keeps_no_bound() -> None:
    assert not at_most("x", float("nan"), 1).passed
    assert not at_least("x", float("nan"), 1).passed


def test_one_broken_case_is_reported_and_the_rest_go_on(device: Device) -> None:
    def fails(bench: Workbench) -> Iterator[Measure]:
        yield at_most("fine", 0, 1)
        yield at_most("too much", 2, 1)

    def crashes(bench: Workbench) -> Iterator[Measure]:
        yield at_most("before", 0, 1)
        raise ZeroDivisionError("in a case")

    def skips(bench: Workbench) -> Iterator[Measure]:
        raise SkipCase("nothing to read EXR with")
        yield

    def measures_nothing(bench: Workbench) -> Iterator[Measure]:
        yield from ()

    def passes(bench: Workbench) -> Iterator[Measure]:
        yield at_least("enough", 3, 2)

    wanted = [_case(n, run) for n, run in enumerate((fails, crashes, skips, measures_nothing, passes))]
    outcomes = list(run_cases(device, wanted))
    assert [o.status for o in outcomes] == ["failed", "crashed", "skipped", "crashed", "passed"]
    assert outcomes[0].worst == Measure("too much", 2, 1)
    assert "in a case" in outcomes[1].message
    assert outcomes[2].message == "nothing to read EXR with"
    assert not passed(outcomes)
    assert passed(outcomes[4:])
    assert passed([outcomes[2], outcomes[4]])


@pytest.mark.parametrize("module", ["penumbra_client", "penumbra_kernels.hardcases"])
def test_json_holds_every_number(device: Device, module: str) -> None:
    result = _selftest("--device", device.info.id, "--case", "far-sphere", "--json", module=module)
    assert result.returncode == Exit.OK, result.stderr
    answer = json.loads(result.stdout)
    assert answer["passed"]
    assert [d["id"] for d in answer["devices"]] == [device.info.id]
    (outcome,) = answer["outcomes"]
    assert (outcome["number"], outcome["status"]) == (8, "passed")
    assert all(m["passed"] and m["value"] <= m["bound"] for m in outcome["measures"])


def test_a_table_shows_measured_numbers_beside_bounds(device: Device) -> None:
    result = _selftest("--case", "far-sphere")
    assert result.returncode == Exit.OK, result.stderr
    assert "far-sphere" in result.stdout
    assert "<= 0.001" in result.stdout
    assert "1 passed" in result.stdout


def test_unknown_cases_and_devices_are_named(device: Device) -> None:
    for words, said in ((("--case", "nope"), "'nope'"), (("--device", "nope:0"), "'nope:0'")):
        result = _selftest(*words)
        assert result.returncode == Exit.USAGE
        assert said in result.stderr


def test_a_failed_case_ends_with_status_1(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    from penumbra_client.cli import main
    from penumbra_kernels.hardcases import selftest

    case = _case(1, lambda bench: iter([at_most("wrong", 2, 1)]))
    monkeypatch.setattr(selftest, "cases", lambda: (case,))
    assert main(["selftest"]) == 1


def test_trees_from_the_cache_are_tested_as_well() -> None:
    """They cannot be written to."""
    for _ in ("built", "from the cache"):
        told = _selftest("--case", "coincident-faces")
        assert told.returncode == 0, told.stdout
