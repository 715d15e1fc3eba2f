"""The program cache: nothing broken comes out of it, whoever else is at it; a warm start compiles nothing at all."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels import cache
from penumbra_kernels.device import Device
from penumbra_kernels.program import BUILD_OPTIONS

HAMMER = """
import os, random, sys
from penumbra_kernels import cache
random.seed(int(sys.argv[1]))
def payload(name):
    return name.encode() * (1 + int(name, 16) % 97)
wrong = hits = 0
for _ in range(400):
    name = f"{random.randrange(24):02x}"
    what = random.random()
    if what < 0.5:
        found = cache.load(name)
        hits += found is not None
        wrong += found is not None and found != payload(name)
    elif what < 0.85:
        cache.store(name, payload(name))
    elif what < 0.93:
        cache.discard(name)
    else:  # a disk that loses the end of a file
        try:
            os.truncate(cache._path(name), random.randrange(40))
        except OSError:
            pass
print(wrong, hits)
"""

START = """
import json, sys, time
from penumbra_kernels import pocl_cache
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene
device = Device(sys.argv[1])
compiled = compile_scene(Scene.model_validate_json(sys.argv[2]), NoAssets())
tracer = Tracer(device, compiled, SamplePlan(2, 4))
before = pocl_cache.compiled()
node = tracer.trace(Tile(0, 0, 8, 8), 0, 4)
print(json.dumps({"builds": device.builds, "late": pocl_cache.compiled() != before, "files": len(before),
                  "bits": node.sums.tobytes().hex(), "scratch": str(pocl_cache.scratch())}))
"""

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective", "transform": [{"translate": [0, 0, 3]}]},
    "film": {"width": 8, "height": 8},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "quad", "origin": [-1, -1, 0], "u": [2, 0, 0], "v": [0, 2, 0]}],
    "lights": [{"type": "point", "position": [0, 0, 2]}],
}


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path))
    return tmp_path


def start(device: Device, count: int = 1) -> list[dict[str, Any]]:
    """What fresh processes, all at once, say of their start; PoCL's cache is a scratch folder in each."""
    environment = {key: value for key, value in os.environ.items() if key != "POCL_CACHE_DIR"}
    command = [sys.executable, "-c", START, device.info.id, json.dumps(SCENE)]
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) for _ in range(count)
    ]
    return [json.loads(process.communicate(timeout=120)[0]) for process in started]


def test_several_processes_at_one_cache_never_read_what_nobody_wrote(
    own: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = 2000
    monkeypatch.setenv("PENUMBRA_CACHE_BYTES", str(limit))
    processes = [
        subprocess.Popen([sys.executable, "-c", HAMMER, str(seed)], stdout=subprocess.PIPE, text=True)
        for seed in range(4)
    ]
    answers = [process.communicate(timeout=120)[0].split() for process in processes]
    assert [int(wrong) for wrong, _ in answers] == [0] * 4
    assert all(int(hits) > 0 for _, hits in answers)
    assert not list((own / "programs").glob("*.tmp"))
    cache.store("last", b"x")
    assert sum(path.stat().st_size for path in (own / "programs").iterdir()) <= limit


def test_the_least_recently_used_entry_goes_first(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PENUMBRA_CACHE_BYTES", str(3 * (100 + 32)))
    for number, name in enumerate("abc"):
        cache.store(name, bytes(100))
        os.utime(cache._path(name), ns=(number, number))
    assert cache.load("a") is not None
    cache.store("d", bytes(100))
    assert [cache.has(name) for name in "abcd"] == [True, False, True, True]


def test_what_a_killed_process_left_is_swept_away(own: Path) -> None:
    cache.store("a", b"x")
    old, new = (own / "programs" / f"{name}.tmp" for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"half")
    long_ago = time.time() - 2 * cache.ABANDONED_SECONDS
    os.utime(old, (long_ago, long_ago))
    cache.store("b", b"x")
    assert not old.exists()
    assert new.exists()


def test_a_folder_in_an_entrys_place_is_replaced(own: Path) -> None:
    """Somebody's mistake would else cost a compilation at every start."""
    (own / "programs" / "a.bin" / "more").mkdir(parents=True)
    assert not cache.has("a")
    assert cache.load("a") is None
    cache.store("a", b"x")
    assert cache.load("a") == b"x"


def test_what_cannot_be_written_leaves_nothing_behind(own: Path) -> None:
    (own / "a").write_text("")
    with pytest.raises(OSError, match=r"Not a directory|File exists"):
        cache.put(own / "a" / "b", b"x")
    assert [path.name for path in own.iterdir()] == ["a"]


@pytest.mark.parametrize("given", ["file", "file/below", "programs is a file"])
def test_a_cache_folder_that_is_none_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "programs").write_text("")
    folder = tmp_path if given == "programs is a file" else tmp_path / given
    monkeypatch.setenv("PENUMBRA_CACHE", str(folder))
    with pytest.raises(
        cache.CacheError, match=r"^PENUMBRA_CACHE: given '.*', but .*; accepted: a folder"
    ) as told:
        cache.made("programs")
    assert repr(str(folder)) in str(told.value)
    if folder != tmp_path:
        with pytest.raises(cache.CacheError):
            cache.check()


def test_a_size_that_is_no_number_is_told(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for given in ("512M", "-1", "1e9"):
        monkeypatch.setenv("PENUMBRA_CACHE_BYTES", given)
        with pytest.raises(
            cache.CacheError, match=f"^PENUMBRA_CACHE_BYTES: given '{given}', accepted: a whole number"
        ):
            cache.check()
    monkeypatch.setenv("PENUMBRA_CACHE_BYTES", "1000")
    cache.check()


def test_a_cache_folder_that_is_not_there_yet_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "a" / "b"))
    cache.check()
    assert not (tmp_path / "a").exists()
    assert cache.made("programs").is_dir()
    monkeypatch.delenv("PENUMBRA_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    (tmp_path / "file").write_text("")
    with pytest.raises(cache.CacheError, match=r"^PENUMBRA_CACHE: not given, but "):
        cache.check()


@pytest.mark.parametrize("damage", ["empty", "short", "flipped", "sound but refused"])
def test_a_broken_entry_is_built_anew(own: Path, device: Device, damage: str) -> None:
    text = "__kernel void k(__global float *out) { out[0] = 3.0f; }"
    fresh = Device(device.info.id)
    fresh.build("damage", {}, text)
    (entry,) = (own / "programs").glob("*.bin")
    data = bytearray(entry.read_bytes())
    if damage == "flipped":
        data[len(data) // 2] ^= 1
    garbage = b"not a program" * 20
    entry.write_bytes(
        {
            "empty": b"",
            "short": bytes(data[:50]),
            "flipped": bytes(data),
            "sound but refused": hashlib.sha256(garbage).digest() + garbage,
        }[damage]
    )
    program = fresh.build("damage", {}, text)
    assert fresh.builds == 2
    out, buffer = np.zeros(4, np.float32), fresh.allocate(16)
    fresh.launch(program.k, [buffer], 1, 1)
    fresh.download(buffer, out)
    assert out[0] == 3
    fresh.build("damage", {}, text)
    assert fresh.builds == 2


def test_the_key_knows_all_that_a_binary_depends_on(device: Device) -> None:
    import dataclasses

    info = device.info
    keys = {
        cache.key("a", BUILD_OPTIONS, info),
        cache.key("b", BUILD_OPTIONS, info),
        cache.key("a", ["-w"], info),
        *(
            cache.key("a", BUILD_OPTIONS, dataclasses.replace(info, **{field: "other"}))
            for field in ("name", "platform", "platform_version", "driver", "target")
        ),
    }
    assert len(keys) == 8
    if info.platform.startswith("Portable"):
        assert "LLVM" in info.platform_version


def test_a_warm_start_compiles_nothing_early_or_late(own: Path, device: Device) -> None:
    """`late`: the driver wrote machine code while it traced."""
    (cold,) = start(device)
    (warm,) = start(device)
    assert (cold["builds"], warm["builds"]) == (1, 0)
    assert not warm["late"]
    assert warm["bits"] == cold["bits"]
    if device.info.platform.startswith("Portable"):
        assert warm["files"] > 0, "the binary holds final code"
    assert not Path(warm["scratch"]).exists(), "the scratch folder goes with its process"


def test_processes_that_start_together_on_an_empty_cache_agree(own: Path, device: Device) -> None:
    together = start(device, 3)
    assert len({answer["bits"] for answer in together}) == 1
    assert start(device)[0]["builds"] == 0


def test_a_program_that_is_held_is_not_loaded_again(own: Path, device: Device) -> None:
    text = "__kernel void k(__global float *out) { out[0] = 4.0f; }"
    fresh = Device(device.info.id)
    held = fresh.build("held", {}, text)
    (entry,) = (own / "programs").glob("*.bin")
    os.utime(entry, (0, 0))
    assert fresh.build("held", {}, text) is held
    assert entry.stat().st_mtime > 0  # that was a use
    first = id(held)
    other = Device(device.info.id).build("held", {}, text)
    assert id(other) != first
    del held
    assert fresh.build("held", {}, text) is not other
    assert fresh.builds == 1
