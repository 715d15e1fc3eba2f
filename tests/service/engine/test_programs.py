"""Which program a scene is rendered with: the one that is ready first, and its own from when it is there; the same bits."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.compiler import Built, Fork
from penumbra_kernels.device import Device, devices
from penumbra_kernels.features import analyse
from penumbra_kernels.history import History
from penumbra_kernels.nodes import SumNode, Tile
from penumbra_kernels.tracer import SamplePlan, Tracer, build_program
from penumbra_scene.check import scene_hash
from penumbra_scene.scene import Scene
from penumbra_service.engine import loaded, programs
from penumbra_service.engine.loaded import LoadedOnDevice
from penumbra_service.engine.opencl import OpenCLBackend
from penumbra_service.engine.programs import Beginning, Programs, planned_seconds
from penumbra_service.engine.protocol import RenderSpec
from penumbra_service.engine.runner import JobRunner

from .conftest import picture

needs_device = pytest.mark.skipif(not devices(), reason="no OpenCL device")
TILE = Tile(0, 0, 24, 16)
SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": [{"translate": [0, 0, 3]}]},
    "film": {"width": 24, "height": 16},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "quad", "origin": [-1, -1, 0], "u": [2, 0, 0], "v": [0, 2, 0]}],
    "lights": [{"type": "point", "position": [0, 0, 2]}],
}


class Bench:
    """A backend with a cache of its own, which it shares with nobody."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.backend = OpenCLBackend()
        self.backend.open(devices()[0].id)

    def spec(self, program: str = "auto", **sections: Any) -> RenderSpec:
        scene = Scene.model_validate({**SCENE, "stop": {"relative_error": 0.01}, **sections})
        path = self.folder / f"{scene_hash(scene).removeprefix('sha256:')}.json"
        path.write_text(scene.model_dump_json())
        return RenderSpec(str(path), scene_hash(scene), None, None, 0.0, 2, 4, program)

    def load(self, spec: RenderSpec) -> LoadedOnDevice:
        while (scene := self.backend.load(spec)) is None:
            time.sleep(0.005)
        return scene

    def built(self) -> int:
        """Programs in the cache."""
        return len(list((self.folder / "cache" / "programs").glob("*.bin")))


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "cache"))
    return Bench(tmp_path)


def until(condition: Any, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def bits(node: SumNode) -> bytes:
    return node.sums.tobytes()


def traced_by(program: str, first: int) -> bytes:
    scene = Scene.model_validate(SCENE)
    plan = SamplePlan(2, 4)
    return bits(
        Tracer(Device(), compile_scene(scene, NoAssets()), plan, program=program).trace(TILE, first, 2)
    )


@needs_device
def test_the_generic_program_begins_and_the_scenes_own_takes_over(bench: Bench) -> None:
    flags = analyse(Scene.model_validate(SCENE)).generic_flags()
    build_program(Device(), flags)  # what `penumbra warm` does
    assert bench.built() == 1
    spec = bench.spec()
    scene = bench.backend.load(spec)
    assert scene is not None, "it had to wait"
    assert (scene.program, scene.compile_warm) == ("generic", True)
    of_the_scene = scene.effects
    begun = bits(scene.trace(TILE, 0, 2, None))
    generic_hash = scene.program_hash

    def go_over() -> bool:
        scene.go_over()
        return scene.program == "specialised"

    until(go_over)
    assert bench.built() == 2
    assert scene.program_hash != generic_hash
    assert scene.background_seconds > 0
    assert scene.effects == of_the_scene
    assert not {name: present for name, present, _, _ in scene.effects}["lens"]
    assert begun == traced_by("specialised", 0)
    assert bits(scene.trace(TILE, 2, 2, None)) == traced_by("generic", 2)
    assert len(History(devices()[0]).read().gains) == 1
    again = bench.backend.load(bench.spec(sampler={"seed": 5}))
    assert again is not None
    assert again.program == "specialised"
    assert bench.built() == 2


@needs_device
def test_on_empty_caches_the_small_program_is_the_only_one_built(bench: Bench) -> None:
    scene = bench.load(bench.spec())
    assert (scene.program, scene.compile_warm, bench.built()) == ("specialised", False, 1)
    (lines, seconds), *more = History(devices()[0]).read().builds
    assert lines > 1000
    assert seconds > 0
    assert not more


@needs_device
def test_a_job_of_few_paths_takes_one_at_a_time_until_a_longer_one_comes(bench: Bench) -> None:
    few = bench.spec(stop={"samples": 1})
    scene = bench.load(few)
    assert (scene.program, scene.compile_warm, bench.built()) == ("specialised", False, 1)
    assert not History(devices()[0]).read().builds, "what it took says nothing of programs with lanes"
    assert bits(scene.trace(TILE, 0, 2, None)) == traced_by("specialised", 0)
    longer = bench.load(bench.spec())
    assert (longer.program, bench.built()) == ("specialised", 2)
    assert longer.program_hash != scene.program_hash
    # Of two that are there the faster one.
    again = bench.load(bench.spec(stop={"samples": 2}))
    assert (again.program_hash, bench.built()) == (longer.program_hash, 2)


@needs_device
def test_a_job_that_takes_longer_than_was_thought_goes_over_to_lanes(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loaded, "LOOK_SECONDS", 0.0)
    monkeypatch.setattr(programs, "planned_paths", lambda scene: 100.0)
    scene = bench.load(bench.spec(stop={"samples": 1}))
    plain = scene.program_hash
    begun = bits(scene.trace(TILE, 0, 2, None))
    scene.go_over()
    assert (scene.program_hash, bench.built()) == (plain, 1)  # nothing is left
    monkeypatch.setattr(programs, "planned_paths", lambda scene: 1e12)

    def go_over() -> bool:
        scene.trace(TILE, 0, 2, None)
        scene.go_over()
        return scene.program_hash != plain

    until(go_over)
    assert (scene.program, bench.built()) == ("specialised", 2)
    assert scene.background_seconds > 0
    assert begun == traced_by("specialised", 0)
    assert bits(scene.trace(TILE, 2, 2, None)) == traced_by("specialised", 2)
    assert not History(devices()[0]).read().gains, "those are of programs that both take sixteen"


@needs_device
def test_many_jobs_of_few_paths_have_lanes_built_in_the_end(
    rooms: Programs, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = Scene.model_validate({**SCENE, "stop": {"samples": 1}})
    features = analyse(few)
    monkeypatch.setattr(Device, "has_binary", lambda self, text: "#define PENUMBRA_TOGETHER 0" in text)
    jobs = 0
    while (begin := rooms.begin(few, features, "auto")).own is None:
        assert (begin.first, begin.plain, begin.order) == ("specialised", True, None)
        rooms.spend(features, 0.25)
        jobs += 1
        assert jobs < 100
    assert jobs > 3
    assert rooms._compiler.orders == [features.flags()]  # type: ignore[attr-defined]


@needs_device
def test_lines_of_the_lanes_count_where_they_are_in(bench: Bench) -> None:
    rooms, features = bench.backend._programs, analyse(Scene.model_validate(SCENE))
    assert rooms is not None
    with_lanes, without = (programs._lines(rooms.text(f)) for f in (features.flags(), features.plain_flags()))
    assert with_lanes > 1.3 * without > 1000


class FakeCompiler:
    """Answers when it is told to."""

    def __init__(self, device_id: str, forked: Fork | None = None) -> None:
        self.orders: list[dict[str, int]] = []
        self.ready: list[Built] = []

    def order(self, flags: dict[str, int]) -> None:
        self.orders.append(dict(flags))

    def answer(self, timeout: float | None = None) -> Built | None:
        return self.ready.pop(0) if self.ready else None


@pytest.fixture
def rooms(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Programs:
    """Programs of this machine's device whose compiler is told what to answer; every generic one is in the cache."""
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path))
    monkeypatch.setattr(programs, "Compiler", FakeCompiler)
    monkeypatch.setattr(Device, "has_binary", lambda self, text: "#define PENUMBRA_LENS 1" in text)
    return Programs(Device())


SHORT = Scene.model_validate({**SCENE, "stop": {"seconds": 0.1}})
LONG = Scene.model_validate({**SCENE, "stop": {"seconds": 100}})


@needs_device
def test_a_job_that_ends_before_its_own_program_is_there_has_none_built(rooms: Programs) -> None:
    features = analyse(SHORT)
    assert rooms.begin(SHORT, features, "auto") == Beginning("generic", plain=False, order=None, own=None)
    begin = rooms.begin(LONG, features, "auto")
    assert (begin.first, begin.order) == ("generic", None)
    assert begin.own is not None
    assert rooms._compiler.orders == [features.flags()]  # type: ignore[attr-defined]


@needs_device
def test_many_short_jobs_have_their_program_built_in_the_end(rooms: Programs) -> None:
    features = analyse(SHORT)
    jobs = 0
    while rooms.begin(SHORT, features, "auto").own is None:
        rooms.spend(features, 0.1)
        jobs += 1
        assert jobs < 1000
    assert jobs > 3


@needs_device
@pytest.mark.parametrize("wanted", ["specialised", "generic"])
def test_a_program_that_was_asked_for_is_taken(rooms: Programs, wanted: str) -> None:
    begin = rooms.begin(LONG, analyse(LONG), wanted)
    assert (begin.first, begin.plain) == (wanted, False)
    assert (begin.order is None) == (wanted == "generic")
    assert begin.own is None


@needs_device
def test_what_other_jobs_have_ordered_is_waited_for(rooms: Programs) -> None:
    features = analyse(LONG)
    alone = rooms._wait(features.flags())
    rooms.order(features.flags())
    assert rooms._wait(features.flags()) == pytest.approx(2 * alone)


@pytest.mark.parametrize(
    ("stop", "rate", "expected"),
    [
        ({"seconds": 5}, None, 5.0),
        ({"seconds": 5}, 1e6, 5.0),
        ({"samples": 64}, None, None),
        ({"samples": 64}, 24 * 16.0, 64.0),
        ({"samples": 64, "seconds": 5}, 24 * 16.0, 5.0),
        ({"relative_error": 0.1}, 1e6, None),
    ],
)
def test_a_stop_rule_tells_how_long_a_job_renders(
    stop: dict[str, float], rate: float | None, expected: float | None
) -> None:
    assert planned_seconds(Scene.model_validate({**SCENE, "stop": stop}), rate) == expected


@needs_device
@pytest.mark.parametrize("trouble", ["bits", "refused", "died"])
def test_what_does_not_work_out_leaves_the_generic_program(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, trouble: str, capfd: pytest.CaptureFixture[str]
) -> None:
    for flags in (analyse(LONG).generic_flags(), *([analyse(LONG).flags()] if trouble == "bits" else [])):
        build_program(Device(), flags)
    monkeypatch.setattr(programs, "Compiler", FakeCompiler)
    monkeypatch.setattr(loaded, "compare", lambda own, other, window: None)
    rooms = bench.backend._programs = Programs(Device())
    monkeypatch.setattr(Device, "has_binary", lambda self, text: "#define PENUMBRA_LENS 1" in text)
    scene = bench.load(bench.spec())
    answers = {
        "bits": Built(1.0, built=True),
        "refused": Built(1.0, built=False, problem="no"),
        "died": Built(0.0, built=False, died=True),
    }
    rooms._compiler.ready = [answers[trouble]]  # type: ignore[attr-defined]
    scene.go_over()
    scene.go_over()
    assert scene.program == "generic"
    assert bits(scene.trace(TILE, 0, 2, None)) == traced_by("generic", 0)
    assert ("other sums" in capfd.readouterr().err) == (trouble == "bits")


def test_a_job_knows_which_program_rendered_what(fake_engine, make_task, monkeypatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("penumbra_service.engine.course.TILE_SIZE", 16)
    monkeypatch.setattr("penumbra_service.jobs.planning.FIRST_LEASE_SAMPLES", 8)
    monkeypatch.setattr("penumbra_service.jobs.planning.MAX_GROWTH", 1)
    reference = JobRunner(fake_engine(), make_task("plain", folder="a")).run()
    result = JobRunner(fake_engine(), make_task("goes-over", folder="b")).run()
    assert picture(result) == picture(reference)
    first, second = result.record.programs
    assert (first.program, second.program) == ("generic", "specialised")
    assert first.leases == 3
    assert second.background_seconds == 0.5
    asked = 32 * 80 * 72  # what was rendered ahead and then dropped comes on top
    assert first.samples + second.samples >= asked
    assert first.first_sample == 0
    assert 0 < first.end <= second.end
    assert second.end >= 4
    assert result.record.program_hash == second.hash
    (only,) = reference.record.programs
    assert only.program == "specialised"
    assert only.samples >= asked
