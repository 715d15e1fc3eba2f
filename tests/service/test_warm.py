"""`penumbra warm`: the usual programs are the examples', each is built once, and a second run builds none."""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import pytest
from penumbra_kernels.device import devices
from penumbra_kernels.features import analyse
from penumbra_kernels.layout import CONSTANTS
from penumbra_kernels.warm import LARGE, SAMPLERS, USUAL, features_of, usual_programs
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
    features = [analyse(parse_scene(path.read_bytes(), allow_files=True)) for path in EXAMPLES.glob("*.json")]
    found = {frozenset(f.present) for f in features}
    assert set(LARGE) == {frozenset(f.present) for f in features if f.large_trees}
    assert set(USUAL) <= found
    assert len(found - set(USUAL)) <= len(found) // 5, "add the new examples' effects to USUAL"
    assert len(USUAL) == len(set(USUAL))


@pytest.mark.parametrize("samplers", [(), ("blue_noise", "random")])
def test_each_program_is_there_once(samplers: tuple[str, ...]) -> None:
    programs = list(usual_programs(samplers))
    assert len({tuple(sorted(flags.items())) for _, flags in programs}) == len(programs)
    assert len({name for name, _ in programs}) == len(programs)


def test_what_is_warm_has_a_program_for_a_scene_that_nobody_has_seen() -> None:
    """The generic one of its sampler; under the default one for adaptive sampling and with layers as well, and built first."""
    effects = {"lens", "deformation", "delta_lights"}
    assert frozenset(effects) not in USUAL
    built = [flags for _, flags in usual_programs()]
    for sampler in SAMPLERS:
        assert features_of(effects, sampler).generic_flags() in built
    assert built[0] == features_of(effects).generic_flags()
    for adaptive, layers in itertools.product((False, True), (set(), {"layers"})):
        assert features_of(effects | layers, adaptive=adaptive).generic_flags() in built[:4]


def test_a_named_sampler_has_the_usual_programs() -> None:
    built = [flags for _, flags in usual_programs(["blue_noise"])]
    assert all(features_of(effects, "blue_noise").flags() in built for effects in USUAL)
    assert features_of((), "blue_noise", adaptive=True).generic_flags() in built
    assert {flags["PENUMBRA_SAMPLER"] for flags in built} == {CONSTANTS["SAMPLER_BLUE_NOISE"]}


@pytest.mark.skipif(not devices(), reason="no OpenCL device")
def test_a_second_run_finds_everything_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """And the compiler has nothing to say about them."""
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    words = (str(path), "--device", devices()[0].id)
    assert run(*words, "--json") == Exit.OK
    out, told = capfd.readouterr()
    assert "warning" not in told.lower()
    lines = [json.loads(line) for line in out.splitlines()]
    assert [(line["program"], line["built"], line["problem"]) for line in lines] == [
        ("generic", True, None),
        ("scene.json", True, None),
    ]
    assert run(*words) == Exit.OK
    assert capfd.readouterr().out.count("in the cache") == 2


def test_what_is_no_scene_and_no_device_is_told(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="cannot read"):
        run(str(tmp_path / "none.json"))
    broken = tmp_path / "broken.json"
    broken.write_text("{}")
    with pytest.raises(CommandError, match=r"broken\.json"):
        run(str(broken))
    with pytest.raises(CommandError, match="nonesuch:7"):
        run("--device", "nonesuch:7")
    with pytest.raises(CommandError, match=r"halton.*sobol"):
        run("--sampler", "halton")
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps(SCENE))
    with pytest.raises(CommandError, match="a scene names its own"):
        run(str(scene), "--sampler", "sobol")
