"""Pilots on a real device: what they foretell comes true, and jobs do not notice them."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.device import Device
from penumbra_scene.job import JobState
from penumbra_scene.parse import scene_from_json
from penumbra_scene.quote import Quote
from penumbra_scene.scene import Scene
from penumbra_service.engine import pilot as pilot_module
from penumbra_service.engine.local import LocalEngine
from penumbra_service.engine.pilot import PilotRunner, PilotTask
from penumbra_service.engine.runner import JobRunner, RenderTask, RunResult
from penumbra_service.engine.task import RunFailedError
from penumbra_service.film import pilot as film_pilot
from penumbra_service.film.predict import error_at
from penumbra_service.jobs.pilot import PilotResult
from penumbra_service.jobs.quote import build_quote

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": {"translate": [0, 0.5, 4]}},
    "film": {"width": 96, "height": 64},
    "sampler": {"seed": 5},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
    "shapes": [
        {"type": "plane", "material": "gray"},
        {"type": "sphere", "material": "gray", "transform": [{"translate": [0, 1, 0]}]},
        {"type": "quad", "origin": [-1, 4, -1], "u": [2, 0, 0], "v": [0, 0, 2], "emission": {"radiance": 6}},
    ],
}


@pytest.fixture(scope="module")
def engine(device: Device) -> Iterator[LocalEngine]:
    with LocalEngine([device.info.id]) as running:
        yield running


@pytest.fixture(autouse=True)
def _time_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a pilot finds must not hang on how busy the machine is."""
    monkeypatch.setattr(pilot_module, "PILOT_SECONDS", 1e4)
    monkeypatch.setattr(pilot_module, "GO_ON_SECONDS", 0.0)


def scene(**sections: Any) -> Scene:
    return scene_from_json({**SCENE, **sections})


def quote(engine: LocalEngine, folder: Path, **sections: Any) -> tuple[Quote, PilotResult]:
    found = PilotRunner(engine, PilotTask(scene(**sections), folder)).run()
    return build_quote(scene(**sections), 0.0, found), found


def test_a_target_takes_the_samples_that_were_quoted(engine: LocalEngine, tmp_path: Path) -> None:
    stop = {"relative_error": 0.02}
    told, found = quote(engine, tmp_path / "quote", stop=stop)
    result = JobRunner(engine, RenderTask("job", scene(stop=stop), tmp_path / "job")).run()
    assert result.state is JobState.FINISHING
    real = result.end * found.layout.replicates
    assert told.end.reason == "relative_error"
    assert real / 1.5 < told.end.samples < real * 1.5
    assert told.end.samples_interval.low <= real <= (told.end.samples_interval.high or 0)
    assert told.pilot.samples == 128
    assert told.pilot.pixels == 96 * 64


@pytest.mark.parametrize("mode", ["certified", "fast"])
def test_an_adaptive_picture_is_quoted_for_the_samples_that_it_takes(
    engine: LocalEngine, tmp_path: Path, mode: str
) -> None:
    """Beside a plane without noise there is a small lamp's light: an even picture takes far more."""
    sections: dict[str, Any] = {
        "stop": {"relative_error": 0.02},
        "environment": {"type": "constant", "radiance": 0.02},
        "shapes": [*SCENE["shapes"][1:], {"type": "quad", "origin": [-9, -9, -4], "u": [18, 0, 0], "v": [0, 18, 0],
                   "emission": {"radiance": 0.5}}],
    }  # fmt: skip
    even, _ = quote(engine, tmp_path / "even", **sections)
    sections["adaptive"] = {"mode": mode}
    told, _ = quote(engine, tmp_path / "quote", **sections)
    record = JobRunner(engine, RenderTask("job", scene(**sections), tmp_path / "job")).run().record
    assert record.adaptive is not None
    real = record.points[-1].samples
    assert real / 1.5 < told.end.samples < real * 1.5
    assert even.end.samples > 1.5 * real
    assert not told.warnings
    rate = told.seconds_per_sample
    if mode == "certified":  # the pilot that is dropped takes its time too
        assert told.end.seconds > told.end.samples * rate


def test_pilots_of_one_seed_are_alike_and_have_samples_of_their_own(
    engine: LocalEngine, tmp_path: Path
) -> None:
    _, one = quote(engine, tmp_path / "one")
    _, two = quote(engine, tmp_path / "two")
    assert [p.relmse for p in one.points] == [p.relmse for p in two.points]
    result = JobRunner(
        engine, RenderTask("job", scene(stop={"samples": 128, "relative_error": 1e-4}), tmp_path / "job")
    ).run()
    own = {p.samples: p.relmse for p in result.record.points}
    for point in one.points:
        assert point.relmse != own[point.samples]
        assert point.relmse == pytest.approx(own[point.samples], rel=0.25)


def test_a_pilot_goes_ahead_of_a_running_job_and_leaves_its_bits_alone(
    engine: LocalEngine, tmp_path: Path
) -> None:
    long = scene(stop={"samples": 65536})
    results: list[RunResult] = []
    began = threading.Event()
    runner = JobRunner(
        engine, RenderTask("job", long, tmp_path / "job"),
        on_progress=lambda state, progress: began.set() if progress.samples_done else None,
    )  # fmt: skip
    thread = threading.Thread(target=lambda: results.append(runner.run()))
    thread.start()
    assert began.wait(120)
    told, _ = quote(engine, tmp_path / "quote")
    assert thread.is_alive()
    assert told.table
    thread.join()
    alone = JobRunner(engine, RenderTask("again", long, tmp_path / "again")).run()
    for a, b in zip(results[0].bands(), alone.bands(), strict=True):
        for name in a.floats:
            assert a.floats[name].tobytes() == b.floats[name].tobytes()


@pytest.mark.parametrize(
    ("sections", "word"),
    [
        ({"sampler": {"type": "regular"}}, "deterministic"),
        ({"sampler": {"replicates": 1}}, "one replicate"),
        ({"shapes": []}, "no noise"),
    ],
)
def test_what_cannot_be_known_is_said(
    engine: LocalEngine, tmp_path: Path, sections: dict[str, Any], word: str
) -> None:
    told, _ = quote(engine, tmp_path, stop={"samples": 32}, **sections)
    assert told.table == ()
    assert told.end.relative_error is None
    assert told.end.samples == 32
    assert told.end.seconds > 0
    assert any(word in warning for warning in told.warnings)


def test_the_nearest_of_several_rules_is_told(engine: LocalEngine, tmp_path: Path) -> None:
    told, _ = quote(engine, tmp_path / "a", stop={"samples": 16, "seconds": 1000, "relative_error": 0.0001})
    assert (told.end.reason, told.end.samples) == ("samples", 16)
    told, found = quote(engine, tmp_path / "b", stop={"samples": 10**6, "seconds": 0.5})
    assert told.end.reason == "seconds"
    assert told.end.seconds == pytest.approx(0.5, rel=1e-6)
    assert told.end.samples == pytest.approx(0.5 / found.seconds_per_sample)


def test_short_of_time_a_pilot_takes_fewer_blocks(
    engine: LocalEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pilot_module, "PILOT_SECONDS", 1e-6)
    told, found = quote(engine, tmp_path)
    assert found.blocks == 1
    assert found.blocks_in_picture == 24
    assert any("too slow" in warning for warning in told.warnings)


def test_with_time_left_a_pilot_goes_on_and_foretells_what_it_would_have(
    engine: LocalEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small picture's planned rounds take a tenth of a second, which is no measure of a rate."""
    _, short = quote(engine, tmp_path / "short")
    monkeypatch.setattr(pilot_module, "GO_ON_SECONDS", 1e4)
    monkeypatch.setattr(film_pilot, "MOST_SAMPLES", 1024)
    told, long = quote(engine, tmp_path / "long")
    assert [p.samples for p in long.points] == [16, 32, 64, 128, 256, 512, 1024]
    assert [p.relmse for p in long.points[:4]] == [p.relmse for p in short.points]
    assert told.pilot.samples == 1024
    foretold = error_at(short.points, 1024)
    assert foretold is not None
    assert foretold[1] <= math.sqrt(long.points[-1].relmse) <= foretold[2]


def test_probes_tell_a_rate_and_nothing_of_the_error(
    engine: LocalEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for least in (0.0, 1e4):  # one probe; as many as there are rounds
        monkeypatch.setattr(pilot_module, "PROBE_SECONDS", least)
        found.append(quote(engine, tmp_path / str(least))[1])
    assert [p.relmse for p in found[0].points] == [p.relmse for p in found[1].points]
    leases = [sum(use.leases for use in one.devices.values()) for one in found]
    assert leases[1] > leases[0]


def test_a_scene_that_cannot_be_loaded_fails_the_quote(engine: LocalEngine, tmp_path: Path) -> None:
    missing = {"asset": "sha256:" + "00" * 32}
    shapes = [{"type": "mesh", "source": missing}]
    with pytest.raises(RunFailedError) as failed:
        quote(engine, tmp_path, shapes=shapes)
    assert failed.value.failure.kind == "scene"
