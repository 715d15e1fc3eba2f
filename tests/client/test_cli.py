"""The command line: exit statuses for scripts, results on standard output, all else on standard error."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from penumbra_client.cli import BUILT_IN, main, make_parser
from penumbra_client.cli.progress import ProgressView, duration, percent
from penumbra_client.cli.quote_view import print_quote
from penumbra_scene.exits import Exit
from penumbra_scene.job import ProgressEvent
from penumbra_scene.quote import Quote
from rich.console import Console

SCENE = {"version": 1, "camera": {"type": "perspective"}, "shapes": [{"type": "sphere"}]}


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    return str(path)


def _ends(service: Any, state: str, **changes: Any) -> None:
    """Lay out a job that ends in this state at once."""
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    service.on("GET /v1/jobs/J1/events", service.stream(service.event(state, progress=1.0)))
    service.on("GET /v1/jobs/J1", service.answer(service.job(state, **changes)))


def _has_results(service: Any) -> None:
    for name in ("result.exr", "thumbnail.png", "heatmap.png", "receipt.json"):
        service.on(f"GET /v1/jobs/J1/{name}", (200, {}, name.encode()))


def test_submit_prints_the_id_alone(service: Any, scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    assert main(["submit", scene]) == Exit.OK
    assert capsys.readouterr().out == "J1\n"


def test_submit_wait_out_leaves_the_results_and_prints_their_paths(
    service: Any, scene: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    interval = {"low": 0.011, "high": 0.013, "confidence": 0.95}
    _ends(
        service,
        "done",
        relative_error=0.0123,
        relative_error_interval=interval,
        samples_done=64.0,
        seconds=1.5,
    )
    _has_results(service)
    out = tmp_path / "out"
    assert main(["submit", scene, "--wait", "--out", str(out)]) == Exit.OK
    said = capsys.readouterr()
    assert "64 samples a pixel in 1.5 s, relative error 1.23 % (95 % interval 1.1 % to 1.3 %)" in said.out
    for name in ("result.exr", "thumbnail.png", "heatmap.png", "receipt.json"):
        assert str(out / name) in said.out
        assert (out / name).read_text() == name
    assert f"{service.address}/jobs/J1" in said.err


def test_settings_replace_sections_and_keep_the_rest_of_them(service: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    sections = {
        "sampler": {"type": "sobol", "replicates": 4},
        "stop": {"samples": 64, "confidence": 0.9},
        "film": {"width": 640, "height": 480, "filter": {"type": "tent"}},
    }
    path.write_text(json.dumps({**SCENE, **sections}))
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    words = "--error 2% --seconds 60 --seed 18446744073709551615 --size 32x16"
    words += " --frame 12 --fps 25 --name x --priority 3 --adaptive fast"
    assert main(["submit", str(path), *words.split()]) == Exit.OK
    sent = service.requests("POST /v1/jobs")[0].json
    del sent["scene"]
    assert sent == {
        "stop": {"seconds": 60.0, "relative_error": 0.02, "confidence": 0.9},
        "sampler": {"type": "sobol", "replicates": 4, "seed": "18446744073709551615"},
        "film": {"width": 32, "height": 16, "filter": {"type": "tent"}},
        "adaptive": {"strategy": "error", "mode": "fast"},
        "frames": "12",
        "fps": 25.0,
        "name": "x",
        "priority": 3,
    }


def test_frames_are_sent_as_they_were_written(service: Any, scene: str) -> None:
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    assert main(["submit", scene, "--frames", "1-24x2", "--fps", "25"]) == Exit.OK
    assert main(["submit", scene, "--frame", "7"]) == Exit.OK
    several, one = service.requests("POST /v1/jobs")
    assert (several.json["frames"], several.json["fps"]) == ("1-24x2", 25)
    assert one.json["frames"] == "7"
    with pytest.raises(SystemExit):
        main(["submit", scene, "--frame", "7", "--frames", "1-2"])


def test_a_target_out_of_reach_is_told_once_and_why_the_job_ended(capsys: pytest.CaptureFixture[str]) -> None:
    told = {
        "target": 0.01, "needed_samples": 900.0, "needed_seconds": 9.0, "cap": "samples", "expected_error": 0.04,
        "message": "a relative error of 1 % needs about 900 samples",
    }  # fmt: skip
    with ProgressView() as view:
        for share in (0.1, 0.5):
            view(
                ProgressEvent.model_validate(
                    {"id": "J1", "state": "rendering", "progress": share, "shortfall": told}
                )
            )
    assert capsys.readouterr().err.count("warning: a relative error of 1 % needs about 900 samples") == 1


def test_without_settings_only_the_scene_is_sent(service: Any, scene: str) -> None:
    service.on("POST /v1/jobs", service.answer(service.job(), 202))
    main(["submit", scene])
    assert service.requests("POST /v1/jobs")[0].json == {"scene": SCENE}


def test_refusals_of_a_job_point_into_the_scenes_file(
    service: Any, scene: str, capsys: pytest.CaptureFixture[str]
) -> None:
    item = {
        "pointer": "/scene/camera/fov",
        "message": "must be greater than 0",
        "given": "-1",
        "accepted": "",
    }
    ours = {**item, "pointer": "/scenery"}
    problem = {"type": "about:blank", "title": "T", "status": 422, "detail": "D", "errors": [item, ours]}
    service.on("POST /v1/jobs", service.answer(problem, 422))
    assert main(["submit", scene]) == Exit.INVALID
    said = capsys.readouterr().err
    assert "at /camera/fov: must be greater than 0" in said
    assert "at /scenery:" in said


@pytest.mark.parametrize("size", ["16x", "x16", "16", "0x16", "16x16x16", "-1x2"])
def test_a_wrong_size_is_shown_as_it_was_given(size: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["submit", "s.json", f"--size={size}"])
    assert f"{size!r} given, WIDTHxHEIGHT accepted" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("state", "status"), [("done", Exit.OK), ("failed", Exit.FAILED), ("cancelled", Exit.CANCELLED)]
)
def test_watch_ends_as_the_job_does(service: Any, state: str, status: Exit) -> None:
    _ends(service, state)
    assert main(["watch", "J1", "--quiet"]) == status


def test_watch_json_prints_every_event_as_a_line(service: Any, capsys: pytest.CaptureFixture[str]) -> None:
    _ends(service, "done")
    events = service.stream(service.event("rendering", progress=0.5), service.event("done", progress=1.0))
    service.on("GET /v1/jobs/J1/events", events)
    assert main(["watch", "J1", "--json"]) == Exit.OK
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["state"], line["progress"]) for line in lines] == [("rendering", 0.5), ("done", 1.0)]


def test_fetch_only_what_is_asked_for(
    service: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _ends(service, "done")
    _has_results(service)
    assert main(["fetch", "J1", "--out", str(tmp_path), "--only", "exr"]) == Exit.OK
    assert capsys.readouterr().out == f"{tmp_path / 'result.exr'}\n"
    assert [p.name for p in tmp_path.iterdir()] == ["result.exr"]


def test_jobs_lists_and_shows(service: Any, capsys: pytest.CaptureFixture[str]) -> None:
    one = service.job("rendering", progress=0.25, relative_error=0.1)
    service.on("GET /v1/jobs", service.answer({"items": [one]}))
    service.on("GET /v1/jobs/J1", service.answer(one))
    assert main(["jobs", "--state", "rendering"]) == Exit.OK
    assert capsys.readouterr().out.split() == ["J1", "rendering", "25", "%", "error", "10", "%", "test"]
    assert main(["jobs", "J1"]) == Exit.OK
    assert json.loads(capsys.readouterr().out)["id"] == "J1"


@pytest.mark.parametrize("verb", ["cancel", "pause", "resume"])
def test_steering_posts_to_every_job(service: Any, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    service.on(f"POST /v1/jobs/J1/{verb}", service.answer(service.job("paused")))
    assert main([verb, "J1", "J1"]) == Exit.OK
    assert capsys.readouterr().out == "J1 paused\nJ1 paused\n"
    assert service.count(f"POST /v1/jobs/J1/{verb}") == 2


def test_an_unknown_job_is_refused(service: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["jobs", "J1"]) == Exit.REFUSED
    assert capsys.readouterr().err.startswith("penumbra: Not found")


def test_no_service_is_its_own_status(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("penumbra_client.client._TRIES", 1)
    assert main(["submit", scene, "--server", "http://127.0.0.1:9"]) == Exit.UNREACHABLE


RANGE = {"low": 1.2, "high": 2.6}
QUOTE: dict[str, Any] = {
    "name": "a ball", "scene_hash": "sha256:a", "picture_hash": "sha256:b", "stop": {"relative_error": 0.02},
    "sampler": "sobol", "replicates": 8, "theta": 1.12, "seconds_per_sample": 0.02,
    "table": [
        {"relative_error": e, "samples": 96 * i, "samples_interval": {"low": 64 * i, "high": 128 * i},
         "seconds": 1.9 * i, "seconds_interval": {"low": 1.2 * i, "high": 2.6 * i}}
        for e, i in ((0.05, 1), (0.02, 6))
    ],
    "end": {"reason": "relative_error", "samples": 576, "samples_interval": RANGE, "seconds": 11.4,
            "seconds_interval": {"low": 7.2, "high": 15.6}, "relative_error": 0.0195},
    "compile": {"seconds": 4.1, "warm": False}, "build": {"seconds": 0.1, "warm": True},
    "pilot": {"pixels": 32000, "blocks": 125, "blocks_in_picture": 300, "samples": 128, "seconds": 1.8},
    "warnings": ["it may be dearer"],
}  # fmt: skip


def test_quote_prints_a_row_for_each_error_and_its_range_on_an_axis(
    service: Any, scene: str, capsys: pytest.CaptureFixture[str]
) -> None:
    service.on("POST /v1/quotes", service.answer(QUOTE))
    assert main(["quote", scene, "--server", service.address, "--error", "2%"]) == Exit.OK
    assert service.asked[-1].json["stop"] == {"relative_error": 0.02}
    said = capsys.readouterr().out.splitlines()
    assert "11.4 s (7.2 s to 15.6 s) of tracing" in said[0]
    assert "4.1 s on top" in said[1]
    assert "it is cached" in said[1]
    (coarse,) = [line for line in said if line.lstrip().startswith("5 %")]
    (fine,) = [line for line in said if line.lstrip().startswith("2 %")]
    assert coarse.split()[2:4] == ["96", "1.9"]
    assert fine.index("●") > coarse.index("●")
    assert fine.count("─") == pytest.approx(coarse.count("─"), abs=2)  # equal factors on a logarithmic axis
    assert said[-1] == "warning: it may be dearer"


def test_quote_says_at_least_where_there_is_no_upper_bound(
    service: Any, scene: str, capsys: pytest.CaptureFixture[str]
) -> None:
    open_row = {
        **QUOTE["table"][1],
        "samples_interval": {"low": 384, "high": None},
        "seconds_interval": {"low": 7.2, "high": None},
    }
    told = {**QUOTE, "table": [QUOTE["table"][0], open_row], "end": {**QUOTE["end"], **open_row}}
    service.on("POST /v1/quotes", service.answer(told))
    assert main(["quote", scene, "--server", service.address, "--error", "2%"]) == Exit.OK
    said = capsys.readouterr().out.splitlines()
    assert "at least 11.4 s of tracing, at least 576 samples a pixel" in said[0]
    (fine,) = [line for line in said if line.lstrip().startswith("2 %")]
    assert fine.split()[2:6] == ["≥", "576", "≥", "11.4"]
    assert fine.index("●") < fine.index("→")  # beyond the end of the axis


@pytest.mark.parametrize("columns", [30, 50, 60, 80, 200])
def test_numbers_of_a_quote_are_never_cut_off(columns: int) -> None:
    """However long a render would take and however narrow the terminal."""
    told = Quote.model_validate(QUOTE)
    scaled = [
        row.model_copy(update={
            "samples": row.samples * 1e9,
            "seconds": row.seconds * 1e6,
            "seconds_interval": row.seconds_interval.model_copy(update={"low": 9e5, "high": None}),
        })
        for row in told.table
    ]  # fmt: skip
    out = io.StringIO()
    console = Console(file=out, width=columns, color_system=None)
    print_quote(told.model_copy(update={"table": tuple(scaled)}), console)
    (line,) = [line for line in out.getvalue().splitlines() if line.lstrip().startswith("2 %")]
    assert line.split()[2:12] == ["5.76e11", "≥", "131", "d", "23", "h", "10", "d", "10", "h"]
    assert ("●" in line) == (columns >= 60)


def test_quote_prints_json_for_programs(service: Any, scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    service.on("POST /v1/quotes", service.answer(QUOTE))
    assert main(["quote", scene, "--url", service.address, "--json"]) == Exit.OK
    assert json.loads(capsys.readouterr().out)["table"][1]["seconds"] == pytest.approx(11.4)


def test_validate_says_where_what_was_given_and_what_is_accepted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({**SCENE, "camera": {"type": "perspective", "fov": 200}}))
    assert main(["validate", str(path)]) == Exit.INVALID
    said = capsys.readouterr().err
    assert "/camera/fov" in said
    assert "given 200" in said
    assert "180" in said.split("accepted")[1]


def test_validate_accepts_a_good_scene(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", scene]) == Exit.OK
    assert capsys.readouterr().out.splitlines()[-1] == f"{scene} is a valid scene"


def test_validate_misses_files_that_are_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({**SCENE, "shapes": [{"type": "mesh", "source": {"file": "cup.ply"}}]}))
    assert main(["validate", str(path)]) == Exit.INVALID
    assert "/shapes/0/source names the file 'cup.ply', but there is no such file" in capsys.readouterr().err


def test_a_scene_that_is_no_json_is_invalid(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text("{")
    assert main(["validate", str(path)]) == Exit.INVALID


@pytest.mark.parametrize(
    "words",
    [
        ["nonsense"],
        ["submit"],
        ["submit", "s.json", "--samples", "0"],
        ["submit", "s.json", "--samples", "1.5"],
        ["submit", "s.json", "--seconds", "nan"],
        ["submit", "s.json", "--error", "150%"],
        ["submit", "s.json", "--error", "-1"],
        ["submit", "s.json", "--seed", "18446744073709551616"],
        ["submit", "s.json", "--size", "320"],
        ["submit", "s.json", "--sampler", "sobel"],
        ["submit", "s.json", "--samp", "3"],
    ],
)
def test_a_wrong_command_line_is_usage(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == Exit.USAGE
    assert "usage: penumbra" in capsys.readouterr().err


def test_percentages_in_a_wrong_option_do_not_break_the_message(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["submit", "s.json", "--error", "%s%d"])
    assert "'%s%d' given" in capsys.readouterr().err


def test_an_address_that_is_none_is_usage(scene: str) -> None:
    assert main(["submit", scene, "--server", "localhost"]) == Exit.USAGE


def test_a_mistake_of_our_own_shows_its_traceback(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(source: str) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("penumbra_client.scenefile.read_scene", broken)
    with pytest.raises(ZeroDivisionError):
        main(["validate", scene])


@pytest.mark.parametrize("name", [*BUILT_IN, "serve", "keys"])
def test_help_teaches_by_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == Exit.OK
    said = capsys.readouterr().out
    assert f"\n  penumbra {name}" in said
    assert max(len(line) for line in said.splitlines()) <= 120


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    for name in (*BUILT_IN, "serve", "keys"):
        assert f"\n    {name} " in said
    for status in Exit:
        if status > 0:
            assert f" {status.value} " in said or f"\n  {status.value} " in said


def test_help_loads_neither_http_nor_numpy_nor_drivers() -> None:
    script = (
        "import sys; from penumbra_client.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "print([m for m in ('httpx', 'rich', 'pydantic', 'numpy', 'pyopencl') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def test_one_command_loads_only_its_own_module() -> None:
    script = (
        "import sys; from penumbra_client.cli import make_parser; make_parser('cancel')\n"
        "print(sorted(m for m in sys.modules if m.startswith('penumbra_client.cli.')))"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "['penumbra_client.cli.options', 'penumbra_client.cli.steer']"


def test_commands_whose_packages_are_missing_are_explained(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Missing:
        name = "serve"

        def load(self) -> None:
            raise ImportError

    monkeypatch.setattr("penumbra_client.plugins.entry_points", lambda group: iter([Missing()]))
    assert main(["serve"]) == Exit.USAGE
    assert "pip install 'penumbra-render[service,cpu]'" in capsys.readouterr().err
    assert "serve" not in make_parser(None).format_help().split("commands:")[1].split("environment:")[0]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0.0 s"),
        (59.94, "59.9 s"),
        (60.0, "1:00 min"),
        (3599.0, "59:59 min"),
        (3661.4, "1:01:01 h"),
        (59.97, "1:00 min"),
        (86399.4, "23:59:59 h"),
        (86400.0, "1 d"),
        (273_600.0, "3 d 4 h"),
        (1e9, "31.7 years"),
        (1e12, "31,700 years"),
        (1e15, "31.7 million years"),
        (None, "?"),
    ],
)
def test_durations_are_written_as_people_do(seconds: float | None, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(("error", "text"), [(0.0123456, "1.23 %"), (None, "unknown"), (0.0, "0 %")])
def test_errors_are_written_as_percentages(error: float | None, text: str) -> None:
    assert percent(error) == text
