"""The compiler's process: what it builds is in the cache, what it cannot build it says, and its death is an answer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.compiler import Built, Compiler, fork, is_cached
from penumbra_kernels.device import Device
from penumbra_kernels.features import analyse
from penumbra_kernels.pocl_cache import VARIABLE
from penumbra_scene.scene import Scene

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "perspective"},
    "integrator": {"max_bounces": 0},
    "shapes": [{"type": "quad"}],
}
FLAGS = analyse(Scene.model_validate(SCENE)).flags()


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path))
    return tmp_path


def test_what_another_process_built_need_not_be_built_here(own: Path, device: Device) -> None:
    compiler = Compiler(device.info.id)
    try:
        assert compiler.answer(0.0) is None
        assert not is_cached(device, FLAGS)
        compiler.order(FLAGS)
        compiler.order(FLAGS)
        assert compiler.answer(0.0) is None
        first, second = compiler.answer(), compiler.answer()
    finally:
        compiler.close()
    assert first is not None
    assert second is not None
    assert (first.built, second.built) == (True, False)
    assert first.seconds > second.seconds
    assert first.problem is second.problem is None
    assert is_cached(device, FLAGS)


def test_the_compilers_words_and_its_death_are_answers(own: Path, device: Device) -> None:
    compiler = Compiler(device.info.id)
    try:
        compiler.order({**FLAGS, "PENUMBRA_SAMPLER": 99})
        answer = compiler.answer()
        assert answer is not None
        assert answer.problem is not None
        assert "DRAW_1D" in answer.problem
        compiler.order(FLAGS)
        compiler.order(FLAGS)
        assert compiler._process is not None
        compiler._process.kill()
        assert [compiler.answer(), compiler.answer()] == [Built(0.0, built=False, died=True)] * 2
        compiler.order(FLAGS)
        again = compiler.answer()
        assert again is not None
        assert json.dumps(again.problem) == "null"
    finally:
        compiler.close()


FORKING = """
import json, os, sys
from penumbra_kernels.compiler import Compiler, fork
forked = fork()
assert forked is not None
compiler = Compiler(sys.argv[1], forked)
compiler.order(json.loads(sys.argv[2]))
built = compiler.answer()
assert built.built and built.problem is None, built
forked.kill()
compiler.order(json.loads(sys.argv[2]))
assert compiler.answer().died
compiler.order(json.loads(sys.argv[2]))
again = compiler.answer()
assert not again.built and not again.died, again
compiler.close()
last = fork()
Compiler(sys.argv[1], last).order(json.loads(sys.argv[2]))
print(last.pid)
sys.stdout.flush()
os._exit(0)
"""


def test_a_forked_compiler_builds_can_be_replaced_and_ends_with_its_parent(own: Path, device: Device) -> None:
    words = [sys.executable, "-c", FORKING, device.info.id, json.dumps(FLAGS)]
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert is_cached(device, FLAGS)
    end, child = time.monotonic() + 60.0, Path("/proc", done.stdout.strip())
    while child.exists() and child.joinpath("stat").read_text().split()[2] != "Z":
        assert time.monotonic() < end
        time.sleep(0.01)
    assert not list((own / "scratch").glob("pocl-*")), "a forked process leaves its scratch folder"


IDLING = """
import json, sys, time
from pathlib import Path
from penumbra_kernels import compiler as module
module.IDLE_SECONDS = 0.2
forked = module.fork()
compiler = module.Compiler(sys.argv[1], forked)

def builders():
    return Path(f"/proc/{forked.pid}/task/{forked.pid}/children").read_text().split()

def until(said):
    end = time.monotonic() + 60
    while not said():
        assert time.monotonic() < end
        time.sleep(0.01)

for again in range(2):
    compiler.order(json.loads(sys.argv[2]))
    built = compiler.answer()
    assert built.problem is None and not built.died, built
    assert built.built == (again == 0), built
    until(lambda: not builders())
maps = Path(f"/proc/{forked.pid}/maps").read_text()
assert "libpocl" not in maps, "no driver in what waits"
compiler.close()
"""


def test_what_builds_goes_when_it_is_idle_and_comes_again(own: Path, device: Device) -> None:
    words = [sys.executable, "-c", IDLING, device.info.id, json.dumps(FLAGS)]
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert not list((own / "scratch").glob("pocl-*"))


def test_a_process_with_threads_forks_no_compiler() -> None:
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        assert fork() is None
    finally:
        done.set()
        thread.join()
