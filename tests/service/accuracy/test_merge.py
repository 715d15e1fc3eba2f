"""`penumbra merge` on real renders: what it makes of them, and what it refuses."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.device import Device
from penumbra_scene.check import picture_hash
from penumbra_scene.job import JobRequest
from penumbra_scene.parse import scene_from_json
from penumbra_service.accuracy.commands import MERGE
from penumbra_service.accuracy.merge import Merged, MergeError, attributes, merge_files
from penumbra_service.commands import CommandError
from penumbra_service.engine.local import LocalEngine
from penumbra_service.images.exr import write_exr
from penumbra_service.images.exr_read import ExrReader, NotARenderError
from penumbra_service.rendering import render_on

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": {"translate": [0, 0, 5]}},
    "film": {"width": 40, "height": 24, "layers": ["albedo"]},
    "stop": {"samples": 16},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
    "shapes": [{"type": "sphere", "material": "gray"}],
    "environment": {"type": "constant"},
}
Made = Callable[..., Path]


@pytest.fixture(scope="module")
def engine(device: Device) -> Iterator[LocalEngine]:
    """One process for all renders."""
    with LocalEngine([device.info.id]) as running:
        yield running


@pytest.fixture(scope="module")
def made(engine: LocalEngine, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """made(seed=1, **sections) -> result.exr of a render; each is made once."""
    done: dict[str, Path] = {}

    def make(seed: int = 1, sampler: str = "sobol", **sections: Any) -> Path:
        scene = {**SCENE, **sections, "sampler": {"type": sampler, "seed": seed}}
        key = json.dumps(scene, sort_keys=True)
        if key not in done:
            out = tmp_path_factory.mktemp("render")
            render_on(engine, JobRequest(scene=scene_from_json(scene)), out, out)
            done[key] = out / "result.exr"
        return done[key]

    return make


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    with ExrReader(path) as reader:
        (band,) = reader.bands()
        return {**band.floats, **band.integers}, reader.attributes


def test_two_seeds_make_one_better_picture(made: Made, tmp_path: Path) -> None:
    out = tmp_path / "both.exr"
    merged = merge_files([made(1), made(2, stop={"samples": 48})], out)
    assert (merged.renders, merged.seeds, merged.samples) == (2, ("1", "2"), 64)
    a, _ = read(made(1))
    b, _ = read(made(2, stop={"samples": 48}))
    both, told = read(out)
    np.testing.assert_allclose(both["G"], 0.25 * a["G"] + 0.75 * b["G"], rtol=1e-6)
    np.testing.assert_allclose(both["Albedo.G"], 0.25 * a["Albedo.G"] + 0.75 * b["Albedo.G"], rtol=1e-6)
    variance = 0.25**2 * a["Variance.G"].astype(float) + 0.75**2 * b["Variance.G"].astype(float)
    np.testing.assert_allclose(both["Variance.G"], variance, rtol=1e-6)
    np.testing.assert_array_equal(both["SampleCount"], 64)
    assert told["penumbra:seed"] == "1 2"
    assert "48 samples of sobol" in told["penumbra:mergedFrom"]
    assert merged.relative_error == pytest.approx(told["penumbra:relativeError"], rel=1e-6)


def test_a_merged_file_can_be_merged_again_but_not_with_its_own_parts(made: Made, tmp_path: Path) -> None:
    two, three, at_once = (tmp_path / name for name in ("two.exr", "three.exr", "at_once.exr"))
    merge_files([made(1), made(2)], two)
    assert merge_files([two, made(3)], three).renders == 3
    merge_files([made(1), made(2), made(3)], at_once)
    np.testing.assert_allclose(read(three)[0]["Variance.R"], read(at_once)[0]["Variance.R"], rtol=1e-5)
    with pytest.raises(MergeError, match="seed 1"):
        merge_files([two, made(1)], tmp_path / "no.exr")
    assert not (tmp_path / "no.exr").exists()


def test_what_is_merged_with_a_biased_render_stays_biased(made: Made, tmp_path: Path) -> None:
    """In either order, also where the merged file is merged again; certified renders are not."""
    fast, contrast = {"adaptive": {"mode": "fast"}}, {"adaptive": {"strategy": "contrast"}}
    for i, parts in enumerate(
        ([made(1), made(2, **fast)], [made(2, **fast), made(1)], [made(2, **fast), made(3, **contrast)])
    ):
        two, three = tmp_path / f"{i}.exr", tmp_path / f"{i}-again.exr"
        merge_files(parts, two)
        merge_files([made(4), two], three)
        for merged in (two, three):
            assert str(read(merged)[1]["penumbra:biased"]).startswith("yes")
            assert "fast" in str(read(merged)[1]["penumbra:adaptive"])
    merge_files([made(1), made(5, adaptive={})], tmp_path / "certified.exr")
    told = read(tmp_path / "certified.exr")[1]
    assert told["penumbra:biased"] == "no"
    assert told["penumbra:adaptive"] == "off; error, certified"


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ({"seed": 1, "stop": {"samples": 32}}, "same, not new"),
        ({"seed": 2, "film": {"width": 40, "height": 25, "layers": ["albedo"]}}, "different pixels"),
        ({"seed": 2, "film": {"width": 40, "height": 24}}, "film.layers"),
        ({"seed": 2, "environment": {"type": "constant", "radiance": 2}}, "different scenes"),
        ({"seed": 2, "integrator": {"max_bounces": 0}}, "different scenes"),
        ({"seed": 2, "sampler": "regular"}, "deterministic"),
        ({"seed": 2, "sampler": "stratified"}, "fixed positions"),
    ],
)
def test_what_does_not_belong_together_is_refused(
    made: Made, tmp_path: Path, other: dict[str, Any], why: str
) -> None:
    with pytest.raises(MergeError, match=why):
        merge_files([made(1), made(**other)], tmp_path / "no.exr")


@pytest.mark.parametrize("other", [{"sampler": "independent"}, {"integrator": {"roulette_start": 2}}])
def test_how_the_picture_is_sampled_may_differ(made: Made, tmp_path: Path, other: dict[str, Any]) -> None:
    assert merge_files([made(1), made(2, **other)], tmp_path / "both.exr").renders == 2


def test_a_file_without_its_attributes_is_refused(made: Made, tmp_path: Path) -> None:
    bare = tmp_path / "bare.exr"
    with ExrReader(made(2)) as reader:
        from penumbra_service.images.exr import ExrLayout

        channels = (reader.float_channels, reader.integer_channels)
        write_exr(bare, ExrLayout(reader.window, *reader.full_size, *channels), reader.bands())
    with pytest.raises(MergeError, match="penumbra:seed"):
        merge_files([made(1), bare], tmp_path / "no.exr")


def test_a_file_that_is_no_render_is_told(made: Made, tmp_path: Path) -> None:
    broken = tmp_path / "broken.exr"
    broken.write_bytes(b"\x76\x2f\x31\x01 and then nothing")
    with pytest.raises(NotARenderError, match=r"broken\.exr"):
        merge_files([made(1), broken], tmp_path / "no.exr")


def run(*words: str) -> int:
    import argparse

    parser = argparse.ArgumentParser()
    MERGE.configure(parser)
    return MERGE.run(parser.parse_args(words))


def test_the_command_prints_what_came_of_it(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "both.exr"
    assert run(str(made(1)), str(made(2)), "-o", str(out), "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert Merged(**{**told, "path": out, "seeds": ("1", "2")}).samples == 32
    shutil.rmtree(tmp_path / "none", ignore_errors=True)
    with pytest.raises(CommandError, match="no such file"):
        run(str(made(1)), str(tmp_path / "none" / "x.exr"), "-o", str(out))


def test_a_render_to_an_error_says_what_was_predicted_and_a_merged_one_does_not(
    made: Made, tmp_path: Path
) -> None:
    target = {"stop": {"relative_error": 0.002}}  # far enough that there is something to foretell
    _, told = read(made(4, **target))
    assert 1.0 <= told["penumbra:theta"] <= 1.5
    assert told["penumbra:predictedSamples"] == pytest.approx(told["penumbra:samples"], rel=1.0)
    assert told["penumbra:predictedSeconds"] > 0
    merge_files([made(4, **target), made(5, **target)], tmp_path / "both.exr")
    assert not {"penumbra:theta", "penumbra:predictedSeconds"} & read(tmp_path / "both.exr")[1].keys()


def test_shadow_rays_are_told_where_only_one_of_the_parts_decided_them() -> None:
    part = {"seed": "1", "sampler": "sobol", "replicates": 4, "samples": 8.0, "seconds": 1.0, "biased": "no"}
    told = attributes([part, {**part, "seed": "2", "shadowRays": 1}])
    assert told["shadowRays"] == "the scene's; 1"
    assert "shadowRays" not in attributes([part, {**part, "seed": "2"}])


def test_unknown_attributes_of_the_parts_are_kept() -> None:
    part = {"seed": "1", "sampler": "sobol", "replicates": 8, "samples": 8.0, "seconds": 1.0, "biased": "no"}
    told = attributes([{**part, "note": "a"}, {**part, "seed": "2", "note": "b", "biased": "adaptive"}])
    assert told["note"] == "a; b"
    assert told["biased"] == "adaptive"


def test_the_picture_hash_tells_what_is_looked_at_apart() -> None:
    scene = scene_from_json(SCENE)
    same = scene_from_json({**SCENE, "name": "b", "stop": {"seconds": 3}, "sampler": {"seed": 9}})
    assert picture_hash(scene) == picture_hash(same)
    assert picture_hash(scene) != picture_hash(scene, time=0.5)
    wider = scene_from_json({**SCENE, "film": {**SCENE["film"], "filter": {"type": "tent"}}})
    assert picture_hash(scene) != picture_hash(wider)
