"""`penumbra compare`: errors against a reference, curves, and what it leaves in a folder."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.device import Device
from penumbra_scene.parse import scene_from_json
from penumbra_service.accuracy import reference as reference_module
from penumbra_service.accuracy.commands import COMPARE
from penumbra_service.accuracy.compare import (
    Comparer,
    Comparison,
    Curve,
    Measured,
    Setting,
    as_set,
    samples_in,
    write_numbers,
)
from penumbra_service.accuracy.comparing import in_words
from penumbra_service.accuracy.plots import plot_curves
from penumbra_service.accuracy.reference import Picture, Reference, own_relmse, relmse_ref
from penumbra_service.commands import CommandError

SCENE: dict[str, Any] = {
    "version": 1,
    "name": "ball",
    "camera": {"type": "perspective", "transform": {"translate": [0, 0, 5]}},
    "film": {"width": 32, "height": 24, "layers": ["albedo"]},
    "integrator": {"max_bounces": 0},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
    "shapes": [
        {"type": "sphere", "material": "gray"},
        {"type": "sphere", "center": [3, 3, 3], "radius": 0.5, "emission": {"radiance": 40}},
    ],
}
SIDE = 64


def noisy(random: np.random.Generator, deviation: float, samples: float = 64) -> Picture:
    """A picture whose true value is 2 everywhere."""
    shape = (SIDE, SIDE, 3)
    return Picture(random.normal(2.0, deviation, shape), np.full(shape, deviation**2), samples)


def test_the_error_against_a_reference_leaves_out_the_references_own() -> None:
    """Oracle: V / (ref^2 + 0.01) with ref = 2."""
    random = np.random.default_rng(1)
    truth = noisy(random, 0.05)
    told = [relmse_ref(noisy(random, 0.1), truth) for _ in range(50)]
    assert np.mean([t.relmse for t in told]) == pytest.approx(0.1**2 / (4 + 0.01), rel=0.01)
    assert all(t.known and t.deviation < 0.05 * t.relmse for t in told)
    assert own_relmse(truth) == pytest.approx(0.05**2 / 4.01, rel=0.01)


def test_an_error_far_below_the_references_own_is_bounded_and_never_negative() -> None:
    """Oracle: E[(m - ref)^2 - V_ref] / 4.01 = V / 4.01, whatever the reference; its deviation is their spread."""
    random = np.random.default_rng(2)
    real = 0.0005**2 / 4.01
    told = [relmse_ref(noisy(random, 0.0005), noisy(random, 0.02)) for _ in range(400)]
    readings = np.array([t.relmse for t in told])
    assert (readings < 0).mean() > 0.3
    assert readings.std() == pytest.approx(np.mean([t.deviation for t in told]), rel=0.2)
    assert all(t.bound > 0 for t in told)
    assert np.mean([real < t.bound for t in told]) > 0.95
    assert np.mean([t.known for t in told]) < 0.05


def curve(name: str, theta: float, rate: float, scale: float = 1.0) -> Curve:
    """relMSE = scale * samples^-theta, `rate` seconds a sample."""
    points = [Measured(n, rate * n, scale * n**-theta, None) for n in (16.0, 32.0, 64.0, 128.0)]
    return Curve(Setting(name, False), points)


def test_slopes_and_times_to_an_error_are_those_of_the_power_law() -> None:
    ours = curve("sobol", 1.3, 0.1)
    assert ours.slope == pytest.approx(-1.3)
    for samples in (20.0, 100.0, 128.0, 300.0):  # between points, at the last, beyond it
        assert ours.seconds_to(samples**-1.3) == pytest.approx(0.1 * samples)
    assert ours.seconds_to(10.0) is None  # before the first
    assert Curve(Setting("sobol", False)).slope is None
    assert samples_in(ours, 6.45) == 64


def test_the_gain_is_the_share_of_the_baselines_seconds() -> None:
    base, ours = curve("independent", 1.0, 0.1), curve("sobol", 1.0, 0.2, scale=0.25)
    found = Comparison("x", "h", 1, 1, "d", 1, 0.0, [ours, base])
    assert found.baseline is base
    assert found.gain(base) == pytest.approx(1.0)
    assert found.gain(ours) == pytest.approx(0.5)  # a quarter of the samples, each twice as dear
    assert Comparison("x", "h", 1, 1, "d", 1, 0.0, [Curve(Setting("regular", True))]).baseline is None


def test_a_reference_is_rendered_once_and_again_where_it_broke(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []

    def render(scene: Any) -> Any:
        made.append(scene)
        return noisy(np.random.default_rng(len(made)), 0.1), None

    scene = scene_from_json(SCENE)
    kept = Reference(1024, tmp_path)
    first = kept.get(scene, 0.0, render)
    again = kept.get(as_set(scene, Setting("jittered", False), 16), 0.0, render)
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert len(made) == 1
    assert made[0].stop.samples == 1024
    assert made[0].sampler.seed == reference_module.SEED
    kept.get(scene, 0.5, render)  # another moment is another picture
    monkeypatch.setattr(reference_module, "kernel_hash", lambda: "f" * 64)
    kept.get(scene, 0.0, render)  # and so are other kernels
    assert len(made) == 3
    for path in tmp_path.iterdir():
        path.write_bytes(b"PK broken")
    kept.get(scene, 0.0, render)
    assert len(made) == 4
    for path in tmp_path.iterdir():
        path.unlink()
        (path / "more").mkdir(parents=True)
    kept.get(scene, 0.0, render)
    kept.get(scene, 0.0, render)
    assert len(made) == 5, "a folder in a reference's place is replaced"


def test_what_the_reference_cannot_tell_is_said_in_words_and_draws_no_line(tmp_path: Path) -> None:
    dark = Curve(
        Setting("sobol", False), [Measured(16, 1.0, 0.01, None), Measured(64, 4.0, None, None, 2.5e-4)]
    )
    base = curve("independent", 1.0, 0.1)
    found = Comparison("x", "h", 4, 3, "d", 128, 1e-3, [base, dark])
    assert dark.told == [(1.0, 0.01)]
    assert dark.slope is None
    assert found.gain(dark) is None
    lines = in_words(found, tmp_path).splitlines()
    (said,) = (line for line in lines if line.startswith("sobol"))
    assert "relMSE below 0.00025" in said
    assert "no slope: the reference can tell fewer than two" in said
    assert "seconds cannot be compared" not in said
    assert any("--reference" in line for line in lines)
    nothing = Curve(Setting("sobol", False), [Measured(64, 4.0, None, None, 2.5e-4)])
    said = in_words(Comparison("x", "h", 4, 3, "d", 1, 1e-3, [nothing]), tmp_path).splitlines()[1]
    assert "no slope of one number of samples" in said
    assert "seconds cannot be compared" in said
    write_numbers(found, tmp_path)
    kept = json.loads((tmp_path / "compare.json").read_text())["curves"][1]["points"][1]
    assert (kept["relmse_ref"], kept["relmse_ref_below"]) == (None, 2.5e-4)
    row = list(csv.DictReader((tmp_path / "compare.csv").open()))[-1]
    assert (row["relmse_ref"], row["relmse_ref_below"]) == ("", "0.00025")
    plot_curves(found, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    COMPARE.configure(parser)
    return COMPARE.run(parser.parse_args(words))


def test_a_scene_is_compared_and_everything_is_written_down(
    device: Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "scene.json", tmp_path / "out"
    scene.write_text(json.dumps(SCENE))
    words = ["--samplers", "independent,sobol,regular", "--samples", "16,64", "--device", device.info.id]
    assert run(str(scene), *words, "--adaptive", "off", "--reference", "2048", "--out", str(out)) == 0
    told = json.loads((out / "compare.json").read_text())
    by_name = {c["sampler"]: c for c in told["curves"]}
    for sampler in ("independent", "sobol"):
        coarse, fine = by_name[sampler]["points"]
        assert fine["relmse_ref"] < coarse["relmse_ref"]
        # pooled by blocks the one, by pixels the other: not the same number, but of one size
        assert 1 / 3 < fine["relmse"] / fine["relmse_ref"] < 3
    assert by_name["regular"]["points"][1]["relmse"] is None
    assert by_name["independent"]["seconds_over_baseline"] == pytest.approx(1.0)
    rows = list(csv.DictReader((out / "compare.csv").open()))
    assert [(r["sampler"], float(r["samples"])) for r in rows[:2]] == [
        ("independent", 16),
        ("independent", 64),
    ]
    for name in ("curves.png", "pictures.png", "pictures/sobol.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert "sobol" in capsys.readouterr().out


def test_few_samples_are_timed_with_the_program_of_many(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[Any] = []
    real = Comparer.render

    def render(self: Any, scene: Any) -> Any:
        picture, result = real(self, scene)
        used.extend((p.program, p.hash) for p in result.record.programs)
        return picture, result

    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(Comparer, "render", render)
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps(SCENE))
    words = ["--samplers", "sobol", "--samples", "16,4096", "--adaptive", "off", "--reference", "16"]
    assert run(str(scene), *words, "--device", device.info.id, "--out", str(tmp_path / "out")) == 0
    assert len(used) >= 3
    assert len(set(used)) == 1


def test_without_matplotlib_the_command_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(CommandError, match=r"penumbra-render\[plots\].*--no-plots"):
        run(str(tmp_path / "scene.json"))


@pytest.mark.parametrize(
    "words",
    [
        ["--samplers", "sobel"],
        ["--adaptive", "maybe"],
        ["--samples", "0"],
        ["--samples", "16,2000000000"],
        ["--samples", "9" * 5000],
        ["--samples", "16,"],
        ["--reference", "-5"],
        ["--reference", "1"],
        ["--reference", "many"],
        ["--size", "3by4"],
        ["--size", "40000x2"],
        ["--size", "32768x32768"],
        ["--size", "0x5"],
    ],
)
def test_words_and_numbers_that_cannot_be_are_told(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run("scene.json", *words)
    assert "accepted" in capsys.readouterr().err


def test_a_curve_that_does_not_fall_never_gets_there() -> None:
    flat = Curve(Setting("regular", False), [Measured(16, 1, 0.1, None), Measured(32, 2, 0.1, None)])
    assert flat.seconds_to(0.01) is None
    assert math.isclose(flat.slope or 0.0, 0.0, abs_tol=1e-9)
