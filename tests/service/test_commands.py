"""The commands that the service's package adds, run as a user runs them."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from penumbra_scene.exits import Exit
from penumbra_scene.parse import job_from_json
from penumbra_scene.receipt import Receipt
from penumbra_service import out_folder
from penumbra_service.out_folder import finished_frames
from penumbra_service.service import RenderService
from penumbra_service.serving import listen, serve, url_of
from penumbra_service.settings import Settings

PENUMBRA = (sys.executable, "-m", "penumbra_client")
SCENE = {
    "version": 1,
    "camera": {"type": "perspective", "transform": {"translate": [0, 0, 5]}},
    "film": {"width": 16, "height": 16},
    "stop": {"samples": 16},
    "shapes": [{"type": "sphere"}],
    "environment": {"type": "constant"},
}
_ANNOUNCEMENT = "Penumbra listens on "


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """The user's, less what would change the commands."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PENUMBRA_")}
    return {
        **kept,
        "PENUMBRA_DATA": str(tmp_path / "data"),
        "PENUMBRA_CACHE": os.environ.get("PENUMBRA_CACHE", str(tmp_path / "cache")),
    }


def _penumbra(*words: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*PENUMBRA, *words], env=environment, capture_output=True, text=True, timeout=200, check=False
    )


@contextmanager
def _serving(environment: dict[str, str], *words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A service on a free port: its address and its process; killed at the end."""
    process = subprocess.Popen(
        [*PENUMBRA, "serve", "--port", "0", *words],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith(_ANNOUNCEMENT), process.communicate()[1]
        yield line.removeprefix(_ANNOUNCEMENT).strip(), process
    finally:
        process.kill()
        process.communicate()


def test_serve_announces_its_address_and_ends_cleanly_when_told(environment: dict[str, str]) -> None:
    with _serving(environment) as (address, process):
        assert httpx.get(f"{address}/health/live").status_code == 200
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == Exit.OK


def test_serve_ends_cleanly_on_ctrl_c(environment: dict[str, str]) -> None:
    with _serving(environment) as (_, process):
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == Exit.OK


@pytest.mark.parametrize(
    "words",
    [
        ("render", "SCENE", "--out", "OUT"),
        ("quote", "SCENE"),
        ("compare", "SCENE", "--out", "OUT", "--no-plots"),
        ("explain", "SCENE", "--measure"),
        ("warm", "SCENE"),
        ("selftest", "--case", "1"),
        ("serve", "--port", "0"),
        ("worker", "--scheduler", "tcp://127.0.0.1:1"),
    ],
    ids=lambda words: words[0],
)
def test_a_cache_that_is_no_folder_is_told_by_every_command(
    environment: dict[str, str], tmp_path: Path, words: tuple[str, ...]
) -> None:
    scene, cache = tmp_path / "scene.json", tmp_path / "cache.txt"
    scene.write_text(json.dumps(SCENE))
    cache.write_text("")
    places = {"SCENE": str(scene), "OUT": str(tmp_path / "out")}
    result = _penumbra(
        *[places.get(word, word) for word in words], environment={**environment, "PENUMBRA_CACHE": str(cache)}
    )
    assert result.returncode == Exit.USAGE
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"penumbra: PENUMBRA_CACHE: given '{cache}', but ")
    assert "accepted: a folder" in line


def test_a_public_address_without_a_key_is_refused(environment: dict[str, str]) -> None:
    result = _penumbra("serve", "--host", "0.0.0.0", "--port", "0", environment=environment)
    assert result.returncode == Exit.USAGE
    assert "API key" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_key_opens_a_public_service_to_its_holder_alone(environment: dict[str, str]) -> None:
    made = _penumbra("keys", "create", "laptop", environment=environment)
    assert made.returncode == Exit.OK
    token = made.stdout.strip()
    with _serving(environment, "--host", "0.0.0.0") as (address, _):
        assert httpx.get(f"{address}/v1/jobs").status_code == 401
        shown = httpx.get(f"{address}/v1/jobs", headers={"Authorization": f"Bearer {token}"})
        assert shown.status_code == 200
        assert httpx.get(f"{address}/health").status_code == 200


def test_the_data_folder_may_stand_on_either_side_of_the_action(
    environment: dict[str, str], tmp_path: Path
) -> None:
    there = str(tmp_path / "there")
    made = _penumbra("keys", "create", "a", "--data", there, environment=environment)
    assert made.returncode == Exit.OK
    assert there in made.stderr
    assert made.stdout.startswith("pnb_")
    assert _penumbra("keys", "--data", there, "list", environment=environment).stdout.rstrip().endswith(" a")
    assert _penumbra("keys", "list", environment=environment).stdout == ""
    again = _penumbra("keys", "create", "a", "--data", there, environment=environment)
    assert (again.returncode, again.stdout) == (Exit.USAGE, "")
    assert "already" in again.stderr


def test_keys_are_listed_without_what_is_secret_and_revoked_by_name(environment: dict[str, str]) -> None:
    token = _penumbra("keys", "create", "laptop", environment=environment).stdout.strip()
    listed = _penumbra("keys", "list", environment=environment).stdout
    assert "laptop" in listed
    assert "active" in listed
    assert token not in listed
    assert _penumbra("keys", "revoke", "laptop", environment=environment).returncode == Exit.OK
    assert "revoked" in _penumbra("keys", "list", environment=environment).stdout
    assert _penumbra("keys", "revoke", "laptop", environment=environment).returncode == Exit.USAGE


def test_a_taken_port_is_told(environment: dict[str, str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = _penumbra("serve", "--port", str(port), environment=environment)
    assert result.returncode == Exit.USAGE
    assert f"port {port}" in result.stderr
    assert "Traceback" not in result.stderr


def test_two_services_do_not_share_a_data_folder(environment: dict[str, str]) -> None:
    with _serving(environment) as (address, _):
        result = _penumbra("serve", "--port", "0", environment=environment)
        assert httpx.get(f"{address}/health/live").status_code == 200
    assert result.returncode == Exit.USAGE
    assert environment["PENUMBRA_DATA"] in result.stderr
    assert "another running service" in result.stderr


@pytest.mark.usefixtures("log_as_before")
def test_a_service_that_cannot_start_does_not_say_that_it_listens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail(self: RenderService) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(RenderService, "start", fail)
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert serve(Settings(data=tmp_path, port=0)) == Exit.INTERNAL
    finally:
        signal.signal(signal.SIGTERM, before)
    assert _ANNOUNCEMENT not in capfd.readouterr().out


def test_settings_that_cannot_be_used_are_told(environment: dict[str, str]) -> None:
    result = _penumbra("serve", "--port", "70000", environment=environment)
    assert result.returncode == Exit.USAGE
    assert "given 70000, accepted: 0 to 65535" in result.stderr


def test_a_free_port_is_kept() -> None:
    with listen("127.0.0.1", 0) as one, listen("127.0.0.1", 0) as two:
        assert one.getsockname()[1] != 0
        assert url_of(one) != url_of(two)


def test_addresses_are_written_as_browsers_take_them() -> None:
    with listen("0.0.0.0", 0) as everywhere:
        assert url_of(everywhere) == f"http://127.0.0.1:{everywhere.getsockname()[1]}"
    if socket.has_ipv6:
        try:
            with listen("[::1]", 0) as six:
                assert url_of(six) == f"http://[::1]:{six.getsockname()[1]}"
        except OSError:
            pytest.skip("this machine has no IPv6 loopback")


def test_devices_are_listed(environment: dict[str, str]) -> None:
    result = _penumbra("devices", "--json", environment=environment)
    found = json.loads(result.stdout)["items"]
    assert result.returncode == (Exit.OK if found else Exit.DEVICE)
    assert all(device["id"] and device["compute_units"] > 0 for device in found)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    return path


def test_render_leaves_all_results(scene: Path, tmp_path: Path, environment: dict[str, str]) -> None:
    out = tmp_path / "out"
    words = ("--out", str(out), "--samples", "32", "--seed", "5", "--quiet", "--measure-effects")
    result = _penumbra("render", str(scene), *words, environment=environment)
    assert (result.returncode, result.stderr) == (Exit.OK, "")
    names = {"result.exr", "thumbnail.png", "heatmap.png", "receipt.json"}
    assert {path.name for path in out.iterdir()} == names
    receipt = Receipt.model_validate_json((out / "receipt.json").read_bytes())
    assert (receipt.samples, receipt.seed) == (32, "5")
    assert receipt.effects_measured is not None
    assert receipt.effects_measured.noise[-1].group == "interactions"
    assert "32 samples a pixel" in result.stdout
    assert str(out / "result.exr") in result.stdout


def test_a_render_of_frames_goes_on_after_ctrl_c(
    tmp_path: Path, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = tmp_path / "triangle.obj"
    mesh.write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n")
    document = {**SCENE, "shapes": [{"type": "mesh", "source": {"file": mesh.name}}]}
    scene, out = tmp_path / "scene.json", tmp_path / "out"
    scene.write_text(json.dumps(document))
    words = ["render", str(scene), "--out", str(out), "--seed", "7"]
    process = subprocess.Popen(
        [*PENUMBRA, *words, "--frames", "1-5000"], env=environment, stderr=subprocess.PIPE, text=True
    )
    receipts = [out / "frames" / f"{n:04d}" / "receipt.json" for n in range(1, 4)]
    deadline = time.monotonic() + 120
    while not all(path.is_file() for path in receipts):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    assert "interrupted" in process.communicate(timeout=60)[1]
    assert process.returncode == Exit.INTERRUPTED
    assert {path.name for path in out.iterdir()} == {"frames", "contact_sheet.png"}

    (out / "frames" / "0003" / "result.exr").unlink()
    before = [path.read_bytes() for path in receipts]
    again = _penumbra(*words, "--frames", "1-3", "--json", environment=environment)
    assert again.returncode == Exit.OK, again.stderr
    assert "2 of 3 frames were there already; --force renders them anew" in again.stderr
    assert [told["frame"] for told in json.loads(again.stdout)] == [1, 2, 3]
    assert [path.read_bytes() == old for path, old in zip(receipts, before, strict=True)] == [
        True,
        True,
        False,
    ]
    assert (out / "frames" / "0003" / "result.exr").is_file()
    forced = _penumbra(*words, "--frames", "1", "--force", environment=environment)
    assert (forced.returncode, "already" in forced.stderr) == (Exit.OK, False)

    def kept(**changes: Any) -> list[int]:
        asked = {"scene": document, "frames": "2-9", "sampler": {"type": "sobol", "seed": "7"}, **changes}
        return sorted(finished_frames(job_from_json(asked, allow_files=True), tmp_path, out))

    assert kept()[:2] == [2, 3]
    assert kept(name="another name", priority=3)[:2] == [2, 3]
    for changes in (
        {"sampler": {"type": "sobol", "seed": "8"}},
        {"stop": {"samples": 32}},
        {"film": {"width": 17, "height": 16}},
        {"fps": 25.0},
        {"measure_effects": True},
    ):
        assert kept(**changes) == []
    with monkeypatch.context() as patch:
        patch.setattr(out_folder, "kernel_hash", lambda: "another")
        assert kept() == []
    receipts[1].write_text(receipts[1].read_text()[:-9])
    assert kept()[:1] == [3]
    mesh.touch()
    assert kept() == []


def test_render_reads_files_beside_the_scene(tmp_path: Path, environment: dict[str, str]) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "triangle.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n")
    path = tmp_path / "scene.json"
    mesh = {"type": "mesh", "source": {"file": "meshes/triangle.obj"}}
    path.write_text(json.dumps({**SCENE, "shapes": [mesh]}))
    result = _penumbra("render", str(path), "--out", str(tmp_path / "out"), environment=environment)
    assert result.returncode == Exit.OK, result.stderr


def test_a_broken_file_beside_the_scene_is_invalid(tmp_path: Path, environment: dict[str, str]) -> None:
    (tmp_path / "broken.ply").write_text("this is no mesh")
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({**SCENE, "shapes": [{"type": "mesh", "source": {"file": "broken.ply"}}]}))
    out = tmp_path / "out"
    result = _penumbra("render", str(path), "--out", str(out), environment=environment)
    assert result.returncode == Exit.INVALID
    assert "broken.ply" in result.stderr
    assert list(out.iterdir()) == []


def test_an_unknown_device_is_device_trouble(
    scene: Path, tmp_path: Path, environment: dict[str, str]
) -> None:
    words = ("--out", str(tmp_path / "out"), "--device", "nonesuch:7")
    result = _penumbra("render", str(scene), *words, environment=environment)
    assert result.returncode == Exit.DEVICE
    assert "nonesuch:7" in result.stderr


def test_explain_says_why_an_effect_is_in(tmp_path: Path, environment: dict[str, str]) -> None:
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps(SCENE))
    told = _penumbra("explain", str(scene), "--json", environment=environment)
    answer = json.loads(told.stdout)
    verdicts = {v["effect"]: v for v in answer["effects"]}
    assert [limit["name"] for limit in answer["not_covered"]] == ["light of long paths"]
    assert verdicts["round"] == {
        "effect": "round",
        "in": True,
        "reason": "shapes/0 is a sphere",
        "pointer": "/shapes/0",
    }
    assert not verdicts["transmission"]["in"]


def test_explain_refuses_what_is_no_scene(tmp_path: Path, environment: dict[str, str]) -> None:
    scene = tmp_path / "scene.json"
    scene.write_text("{}")
    told = _penumbra("explain", str(scene), environment=environment)
    assert told.returncode == Exit.INVALID
    assert "version" in told.stderr
    assert (
        _penumbra("explain", str(tmp_path / "none.json"), environment=environment).returncode == Exit.INVALID
    )
    for option in ("--time", "--budget"):
        refused = _penumbra("explain", str(scene), option, "nan", environment=environment)
        assert refused.returncode == Exit.USAGE
        assert f"{option}: " in refused.stderr
        assert "nan" in refused.stderr
