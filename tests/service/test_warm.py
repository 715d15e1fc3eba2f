"""`penumbra warm`: the usual programs are the examples', each is built once, and a second run builds none."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest
from penumbra_kernels.device import devices
from penumbra_kernels.features import analyse
from penumbra_kernels.warm import USUAL, features_of, programs_of
from penumbra_scene.exits import Exit
from penumbra_scene.parse import parse_scene
from penumbra_service.commands import CommandError
from penumbra_service.warm import WARM

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCENE = {
    "version": 1,
    "camera": {"type": "perspective"},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "quad"}],
}


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    WARM.configure(parser)
    return WARM.run(parser.parse_args(words))


def test_the_usual_programs_are_those_of_the_examples() -> None:
    found = {
        frozenset(analyse(parse_scene(path.read_bytes(), allow_files=True)).present)
        for path in EXAMPLES.glob("*.json")
    }
    assert set(USUAL) <= found
    assert len(found - set(USUAL)) <= len(found) // 5, "add the new examples' effects to USUAL"
    assert len(USUAL) == len(set(USUAL))


def test_each_program_is_named_once() -> None:
    programs = list(programs_of([]))
    assert len({tuple(sorted(flags.items())) for _, flags in programs}) == len(programs)
    with_layers = {tuple(sorted(features_of(e).generic_flags().items())) for e in USUAL}
    assert len(programs) == len(USUAL) + len(with_layers)


def test_what_is_warm_has_a_program_for_a_scene_that_nobody_has_seen() -> None:
    """The generic one, built first."""
    effects = {"lens", "deformation", "delta_lights"}
    assert frozenset(effects) not in USUAL
    name, flags = next(iter(programs_of([])))
    assert name == "generic"
    assert flags == features_of(effects).generic_flags()


@pytest.mark.skipif(not devices(), reason="no OpenCL device")
def test_a_second_run_finds_everything_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    words = (str(path), "--device", devices()[0].id)
    assert run(*words, "--json") == Exit.OK
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["program"], line["built"], line["problem"]) for line in lines] == [
        ("generic", True, None),
        ("scene.json", True, None),
    ]
    assert run(*words) == Exit.OK
    assert capsys.readouterr().out.count("in the cache") == 2


def test_what_is_no_scene_and_no_device_is_told(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="cannot read"):
        run(str(tmp_path / "none.json"))
    broken = tmp_path / "broken.json"
    broken.write_text("{}")
    with pytest.raises(CommandError, match=r"broken\.json"):
        run(str(broken))
    with pytest.raises(CommandError, match="nonesuch:7"):
        run("--device", "nonesuch:7")
