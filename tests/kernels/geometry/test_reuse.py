"""Trees are found again by their content, in memory and on disk, and give the hits of trees that are built anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.accel.build import STATIC, Items
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.compile.geometry import CompiledGeometry, compile_geometry
from penumbra_scene.scene import Scene

ONCE = np.ones(1, np.int64)


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path))
    return tmp_path


def _items(n: int, seed: int) -> Items:
    lo = np.random.default_rng(seed).random((n, 3), np.float32)
    return Items(lo, lo + np.float32(0.01), np.full(n, STATIC, np.int32), np.arange(n, dtype=np.uint32))


def _bumpy(size: int) -> tuple[Any, Any]:
    """A height field of 2 size^2 triangles."""
    x, z = np.meshgrid(np.linspace(-2, 2, size + 1), np.linspace(-2, 2, size + 1), indexing="ij")
    y = 0.1 * np.sin(7 * x) * np.cos(9 * z)
    a = (np.arange(size)[:, None] * (size + 1) + np.arange(size)[None, :]).ravel()
    faces = np.concatenate(
        [np.stack([a, a + size + 1, a + 1], 1), np.stack([a + 1, a + size + 1, a + size + 2], 1)]
    )
    return np.stack([x, y, z], -1).reshape(-1, 3), faces


def _scene(kit: Any, size: int = 40) -> tuple[dict[str, Any], Any]:
    """A still mesh of many triangles, and a ball that crosses it while the shutter is open."""
    meshes = kit.Meshes()
    keys = [{"time": t, "transform": [{"translate": [t - 1.5, 0, 0]}]} for t in (0, 3)]
    ball = {"type": "sphere", "center": [0, 0.2, 0], "radius": 0.4, "transform": {"keyframes": keys}}
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 0.5}}
    return {"version": 1, "camera": camera, "shapes": [meshes.add(*_bumpy(size)), ball]}, meshes


def _compile(scene: dict[str, Any], meshes: Any, time: float, trees: Trees | None = None) -> CompiledGeometry:
    return compile_geometry(Scene.model_validate(scene), meshes, time, np.zeros(3), {}, trees)


def test_the_same_content_is_built_once_and_other_content_again() -> None:
    trees = Trees()
    first = trees.tree(_items(100, 1), ONCE)
    assert trees.tree(_items(100, 1), ONCE) is first
    assert trees.built == 1
    assert trees.tree(_items(100, 2), ONCE) is not first
    assert trees.built == 2


def test_memory_keeps_what_was_used_last() -> None:
    one = Trees().tree(_items(100, 1), ONCE).bytes
    trees = Trees(kept_bytes=int(2.5 * one))
    for seed in (1, 2, 1, 3, 1):
        trees.tree(_items(100, seed), ONCE)
    assert trees.built == 3
    trees.tree(_items(100, 2), ONCE)
    assert trees.built == 4


def test_large_trees_are_found_on_disk_and_damaged_ones_are_built_again(own_cache: Path) -> None:
    items = _items(3000, 4)
    built = Trees().tree(items, ONCE)
    found_by = Trees()
    found = found_by.tree(items, ONCE)
    assert found_by.built == 0
    assert (found.root, found.stack) == (built.root, built.stack)
    for name in ("nodes", "packet_items", "packet_keyframe"):
        assert getattr(found, name).tobytes() == getattr(built, name).tobytes()
    (entry,) = own_cache.rglob("*.bin")
    data = bytearray(entry.read_bytes())
    data[len(data) // 2] ^= 1
    entry.write_bytes(data)
    again = Trees()
    assert again.tree(items, ONCE).nodes.tobytes() == built.nodes.tobytes()
    assert again.built == 1


def test_a_frame_builds_only_what_moved(kit: Any) -> None:
    scene, meshes = _scene(kit)
    trees = Trees()
    _compile(scene, meshes, 0.0, trees)
    before = trees.built
    _compile(scene, meshes, 1.0, trees)
    assert trees.built == before + 1  # the few boxes of the instances and of what stands still
    _compile(scene, meshes, 1.0, trees)
    assert trees.built == before + 1


def _changing(kit: Any, what: str) -> tuple[dict[str, Any], Any]:
    """A still mesh of many triangles, and beside it something that is not the same in another frame."""
    scene, meshes = _scene(kit)
    scene["camera"] = {"type": "perspective"}  # the shutter is open for no time: nothing moves while it is
    still, ball = scene["shapes"]
    if what == "deformed":
        positions, faces = _bumpy(6)
        forms = [(positions + np.array([0, 0.3 + height, 0])).tolist() for height in (0, 0.2)]
        keys = [{"time": 3 * i, "positions": form} for i, form in enumerate(forms)]
        ball = {"type": "mesh", "positions": forms[0], "indices": faces.tolist(), "deformation": keys}
    if what == "deforming while the shutter is open":
        return _changing_shutter(_changing(kit, "deformed"))
    return {**scene, "shapes": [ball, still]}, meshes


def _changing_shutter(made: tuple[dict[str, Any], Any]) -> tuple[dict[str, Any], Any]:
    scene, meshes = made
    return {**scene, "camera": {"type": "perspective", "shutter": {"open": 0, "close": 0.5}}}, meshes


CHANGES = ["moved", "deformed", "deforming while the shutter is open"]


@pytest.mark.parametrize("what", CHANGES)
def test_what_changes_between_frames_is_built_alone(kit: Any, what: str) -> None:
    """Its own tree, and the one above both; between the same two forms of a mesh that deforms in the shutter, nothing."""
    scene, meshes = _changing(kit, what)
    trees = Trees()
    large: list[int] = []
    build = trees._from_disk_or_built

    def count(key: str, items: Items, copies: Any) -> Any:
        large.append(len(items.lo))
        return build(key, items, copies)

    trees._from_disk_or_built = count  # type: ignore[method-assign]
    _compile(scene, meshes, 0.0, trees)
    own = 1 if what == "moved" else 72
    assert sorted(large) == sorted([2, own, 3200])
    again = [] if what == CHANGES[2] else sorted([2, own])
    for frame in (1, 2):
        large.clear()
        before = trees.built
        _compile(scene, meshes, float(frame), trees)
        assert sorted(large) == again
        assert trees.built == before + len(again)


@pytest.mark.parametrize("what", CHANGES)
def test_a_changing_part_of_its_own_gives_the_hits_of_one_tree(
    probe: Any, kit: Any, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    scene, meshes = _changing(kit, what)
    rng = np.random.default_rng(9)
    origins, directions = rng.uniform(-2, 2, (4000, 3)), kit.directions(rng, 4000)
    shutter = 0.5 if what == CHANGES[2] else 0.0
    rays = kit.rays(origins, directions, time=rng.uniform(1, 1 + shutter, 4000))
    parts = probe.trace(_compile(scene, meshes, 1.0), rays)
    monkeypatch.setattr("penumbra_kernels.compile.geometry.SWEEP_LIMIT", 1 << 30)
    one = probe.trace(_compile(scene, meshes, 1.0), rays)
    assert (one["kind"] == kit.TRIANGLE).sum() > 500
    assert one.tobytes() == parts.tobytes()


@pytest.mark.parametrize("time", [0.0, 1.0])
def test_a_still_part_below_the_instances_gives_the_hits_of_one_tree(
    probe: Any, kit: Any, monkeypatch: pytest.MonkeyPatch, time: float
) -> None:
    scene, meshes = _scene(kit)
    rng = np.random.default_rng(8)
    rays = kit.rays(
        rng.uniform(-2, 2, (4000, 3)), kit.directions(rng, 4000), time=rng.uniform(time, time + 0.5, 4000)
    )
    two = probe.trace(_compile(scene, meshes, time), rays)
    monkeypatch.setattr("penumbra_kernels.compile.geometry.SWEEP_LIMIT", 1 << 30)
    one = probe.trace(_compile(scene, meshes, time), rays)
    assert {kit.TRIANGLE, kit.SPHERE} <= set(one["kind"])
    assert one.tobytes() == two.tobytes()
