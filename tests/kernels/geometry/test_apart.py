"""Large trees are built in a process of their own: the same trees, whatever becomes of that process; and how much memory a
mesh takes on its way to the device, in bytes that numpy asks for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.accel.apart import TreeBuilder
from penumbra_kernels.accel.build import STATIC, Items, Tree, build_tree
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.assets import MeshData
from penumbra_kernels.compile.geometry import compile_geometry
from penumbra_scene.scene import Scene

ONCE = np.ones(1, np.int64)
COUNT = 3000


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture
def builder() -> Iterator[TreeBuilder]:
    made = TreeBuilder()
    yield made
    made.close()


def items(seed: int = 1) -> Items:
    lo = np.random.default_rng(seed).random((COUNT, 3), np.float32)
    number = np.arange(COUNT, dtype=np.uint32)
    return Items(lo, lo + np.float32(0.01), np.full(COUNT, STATIC, np.int32), number)


def same(a: Tree, b: Tree) -> bool:
    parts = ("nodes", "packet_items", "packet_keyframe")
    equal = all(getattr(a, part).tobytes() == getattr(b, part).tobytes() for part in parts)
    return equal and (a.root, a.stack) == (b.root, b.stack)


def test_the_tree_is_the_same_and_the_process_goes_on(builder: TreeBuilder, own_cache: Path) -> None:
    first = builder(items(1), ONCE)
    process = builder._process
    assert same(first, build_tree(items(1), ONCE))
    assert same(builder(items(2), ONCE), build_tree(items(2), ONCE))
    assert builder._process is process
    assert not list(own_cache.iterdir()), "what it was given is removed"


def test_one_that_has_ended_is_started_again(builder: TreeBuilder) -> None:
    builder(items(1), ONCE)
    assert builder._process is not None
    before = builder._process
    before.send_signal(signal.SIGKILL)
    before.wait()
    assert same(builder(items(2), ONCE), build_tree(items(2), ONCE))
    assert builder._process is not before


def test_what_killed_processes_have_left_is_removed_once_it_is_old(
    builder: TreeBuilder, own_cache: Path
) -> None:
    for name, age in (("tree-old", 7200), ("tree-new", 60), ("programs", 7200)):
        (own_cache / name).mkdir()
        os.utime(own_cache / name, (time.time() - age,) * 2)
    builder(items(), ONCE)
    assert sorted(path.name for path in own_cache.iterdir()) == ["programs", "tree-new"]


def test_one_that_cannot_work_costs_nothing_but_time() -> None:
    builder = TreeBuilder((sys.executable, "-c", "raise SystemExit(3)"))
    assert same(builder(items(), ONCE), build_tree(items(), ONCE))
    assert builder._process is None


def test_a_cache_that_cannot_be_written_does_not_hinder(
    builder: TreeBuilder, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (own_cache / "file").touch()
    monkeypatch.setenv("PENUMBRA_CACHE", str(own_cache / "file"))
    assert same(builder(items(), ONCE), build_tree(items(), ONCE))


def test_whoever_has_it_built_does_not_load_numba_and_takes_it_along(own_cache: Path) -> None:
    code = (
        "import sys, numpy as np\n"
        "from penumbra_kernels.accel.apart import TreeBuilder\n"
        "from penumbra_kernels.accel.build import Items\n"
        "from penumbra_kernels.accel.trees import Trees\n"
        "lo = np.random.default_rng(0).random((3000, 3), np.float32)\n"
        "given = Items(lo, lo + 1, np.zeros(3000, np.int32), np.zeros(3000, np.uint32))\n"
        "builder = TreeBuilder()\n"
        "Trees(build_large=builder).tree(given, np.ones(1, np.int64))\n"
        "assert 'numba' not in sys.modules\n"
        "print(builder._process.pid, flush=True)\n"
        "import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    pid = int(done.stdout)
    for _ in range(1000):
        if not alive(pid):
            return
        time.sleep(0.01)
    raise AssertionError("it outlives its parent")


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Held:
    """Assets that are there already, as memory-mapped ones are."""

    def __init__(self, data: MeshData) -> None:
        self._data = data

    def image(self, ref: Any) -> Any:
        raise AssertionError

    def mesh(self, ref: Any) -> MeshData:
        return self._data


def grid(size: int) -> MeshData:
    """A height field of 2 size^2 triangles."""
    x, z = np.meshgrid(np.linspace(-2, 2, size + 1), np.linspace(-2, 2, size + 1), indexing="ij")
    a = (np.arange(size)[:, None] * (size + 1) + np.arange(size)[None, :]).ravel()
    faces = [np.stack([a, a + size + 1, a + 1], 1), np.stack([a + 1, a + size + 1, a + size + 2], 1)]
    positions = np.stack([x, 0.1 * np.sin(7 * x) * np.cos(9 * z), z], -1).reshape(-1, 3)
    return MeshData(positions, np.concatenate(faces).astype(np.uint32))


MOST_BYTES = 110
"""A triangle: 75 for the device, 32 of boxes, some of the tree that packets are filled from."""
FIXED = 16 << 20
"""Temporaries of one chunk, whatever the mesh has."""


def test_a_mesh_takes_no_more_memory_than_what_it_becomes() -> None:
    data = grid(512)
    mesh = {"type": "mesh", "source": {"file": "mesh.ply"}}
    scene = Scene.model_validate({"version": 1, "camera": {"type": "perspective"}, "shapes": [mesh]})
    builder = TreeBuilder()
    try:
        tracemalloc.start()
        compile_geometry(scene, Held(data), 0.0, np.zeros(3), {}, Trees(build_large=builder))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        builder.close()
    assert peak < FIXED + MOST_BYTES * len(data.indices)
