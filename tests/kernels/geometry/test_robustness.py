"""Degenerate input, ties, NaN, and programs that must give the same bits (hard cases 11, 12, 14, 17)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.assets import AssetError
from penumbra_kernels.hardcases.benches.meshes import soup

RAYS = 20_000


def _random_rays(rng: np.random.Generator, kit: Any, n: int = RAYS) -> Any:
    origins = kit.directions(rng, n) * 3
    return kit.rays(origins, rng.uniform(-1, 1, (n, 3)) - origins)


def _same(a: Any, b: Any) -> bool:
    return bool(a.tobytes() == b.tobytes())


def test_both_builders_give_the_same_hits(probe: Any, kit: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from penumbra_kernels.accel import build

    rng = np.random.default_rng(4)
    vertices, faces = soup(rng, 1500)
    meshes = kit.Meshes()
    shape = meshes.add(vertices, faces)
    rays = _random_rays(rng, kit)
    swept = probe.trace(kit.compiled([shape], meshes), rays)
    plain = build.build_tree
    monkeypatch.setattr(
        "penumbra_kernels.accel.trees.build_tree", lambda *arguments: plain(*arguments, sweep_limit=0)
    )
    assert _same(swept, probe.trace(kit.compiled([shape], meshes), rays))


def test_the_same_bits_with_and_without_builtins(device: Any, kit: Any) -> None:
    """The portable branch, clang's builtins, and x86's: one result."""
    rng = np.random.default_rng(5)
    vertices, faces = soup(rng, 300)
    meshes = kit.Meshes()
    shapes = [
        meshes.add(vertices, faces),
        {"type": "sphere", "center": [0.5, 0, 0], "radius": 0.3},
        {"type": "disc", "center": [-0.5, 0, 0], "radius": 0.3},
        {"type": "plane", "point": [0, -1, 0]},
        {"type": "sphere", "center": [0.5, 0.7, 0], "radius": 0.3, "transform": {"scale": [1, 2, 1]}},
    ]
    geometry = kit.compiled(shapes, meshes)
    rays = _random_rays(rng, kit)
    kinds = [{"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0}]
    if device.info.kind == "cpu":
        kinds.append({"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_BUILTINS": 1, "PENUMBRA_X86": 0})
        kinds.append(device.flags | {"PENUMBRA_X86": _is_x86()})
    answers = [kit.Probe(device, kind).trace(geometry, rays) for kind in kinds]
    for other in answers[1:]:
        assert _same(answers[0], other)


def _is_x86() -> int:
    import platform

    return int(platform.machine() in ("x86_64", "AMD64"))


SPECIALISED = [
    ({}, {"ROUND": 0, "INSTANCING": 0, "MOTION": 0, "DEFORMATION": 0, "TEXTURES": 0}),
    ({"round": 1}, {"INSTANCING": 0, "MOTION": 0, "DEFORMATION": 0}),
    ({"instance": 1}, {"ROUND": 0, "MOTION": 0, "DEFORMATION": 0}),
    ({"instance": 1, "moving": 1}, {"ROUND": 0, "DEFORMATION": 0}),
    ({"deforming": 1}, {"ROUND": 0, "INSTANCING": 0, "MOTION": 0}),
]


@pytest.mark.parametrize(("content", "effects"), SPECIALISED)
def test_the_same_bits_with_and_without_unused_effects(
    device: Any, probe: Any, kit: Any, content: dict[str, int], effects: dict[str, int]
) -> None:
    rng = np.random.default_rng(6)
    vertices, faces = soup(rng, 100)
    meshes = kit.Meshes()
    mesh = meshes.add(vertices, faces)
    shapes = [mesh]
    if "round" in content:
        shapes += [
            {"type": "sphere", "radius": 0.5},
            {"type": "disc", "center": [0, 1, 0]},
            {"type": "plane", "point": [0, -1, 0]},
        ]
    if "deforming" in content:
        keys = [{"time": t, "positions": (vertices * (1 + t)).tolist()} for t in (0.0, 0.4, 1.0)]
        shapes.append({**mesh, "deformation": keys})
    turn = [{"rotate": {"axis": [1, 1, 0], "angle": 60}}]
    moving = {"keyframes": [{"time": 0, "transform": []}, {"time": 1, "transform": turn}]}
    if "instance" in content:
        shapes.append(
            {"type": "instance", "prototype": "p", "transform": moving if "moving" in content else turn}
        )
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 1}}
    geometry = kit.compiled(shapes, meshes, prototypes={"p": [mesh]}, camera=camera)
    rays = _random_rays(rng, kit)
    rays[:, 7] = rng.random(RAYS)
    special = kit.Probe(device, **effects)
    assert _same(special.trace(geometry, rays), probe.trace(geometry, rays))


def test_nothing_is_met_behind_the_origin_or_beyond_tmax(probe: Any, kit: Any) -> None:
    rng = np.random.default_rng(8)
    vertices, faces = soup(rng, 200)
    meshes = kit.Meshes()
    shapes = [
        meshes.add(vertices, faces),
        {"type": "sphere", "radius": 0.5},
        {"type": "disc"},
        {"type": "plane"},
    ]
    geometry = kit.compiled(shapes, meshes)
    rays = _random_rays(rng, kit)
    free = probe.trace(geometry, rays)
    met = free["kind"] != kit.NONE
    just = rays[met].copy()
    just[:, 6] = free["t"][met]
    assert not probe.trace(geometry, just)["occluded"].any()
    just[:, 6] = np.nextafter(free["t"][met], np.float32(np.inf))
    assert _same(probe.trace(geometry, just), free[met])
    assert (free["t"][met] > 0).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_a_mesh_with_a_broken_vertex_is_refused_by_name(kit: Any, value: float) -> None:
    meshes = kit.Meshes()
    broken = meshes.add([[0, 0, 0], [1, 0, 0], [0, value, 0]], [[0, 1, 2]])
    with pytest.raises(AssetError, match=r"shapes/1: vertex 2 .* finite"):
        kit.compiled([{"type": "sphere"}, broken], meshes)
