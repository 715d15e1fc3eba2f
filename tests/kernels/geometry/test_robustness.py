"""Degenerate input, ties, NaN, and programs that must give the same bits (hard cases 11, 12, 14, 17)."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.assets import AssetError

RAYS = 20_000


def _soup(rng: np.random.Generator, n: int, size: float = 0.2) -> tuple[Any, Any]:
    centers = rng.uniform(-1, 1, (n, 1, 3))
    vertices = (
        (centers + rng.normal(size=(n, 3, 3)) * size).reshape(-1, 3).astype(np.float32).astype(np.float64)
    )
    return vertices, np.arange(3 * n).reshape(-1, 3)


def _random_rays(rng: np.random.Generator, kit: Any, n: int = RAYS) -> Any:
    origins = kit.directions(rng, n) * 3
    return kit.rays(origins, rng.uniform(-1, 1, (n, 3)) - origins)


def _same(a: Any, b: Any) -> bool:
    return bool(a.tobytes() == b.tobytes())


def test_degenerate_triangles_change_no_other_hit_and_give_no_nan(probe: Any, kit: Any) -> None:
    rng = np.random.default_rng(1)
    vertices, faces = _soup(rng, 200)
    needle = np.array([[-1, 0.1, 0], [1, 0.1, 0], [0, 0.1 + 1e-6, 0]])
    flat = np.array([[-1, 0, 0], [0, 0, 0], [1, 0, 0]])
    meshes = kit.Meshes()
    clean = kit.compiled(
        [meshes.add(np.concatenate([vertices, needle]), np.concatenate([faces, [[600, 601, 602]]]))], meshes
    )
    bad_vertices = np.concatenate([vertices, needle, flat])
    bad_faces = np.concatenate([faces, [[600, 601, 602]], [[603, 604, 605]], [[0, 0, 1]], [[5, 5, 5]]])
    dirty = kit.compiled([meshes.add(bad_vertices, bad_faces)], meshes)
    rays = _random_rays(rng, kit)
    rays[::10, 3:6] = (
        np.float32(needle[0] + rng.random((RAYS // 10, 1)) * (needle[1] - needle[0])) - rays[::10, :3]
    )
    a, b = probe.trace(clean, rays), probe.trace(dirty, rays)
    assert _same(a, b)
    met = b["kind"] == kit.TRIANGLE
    assert np.count_nonzero(b["primitive"][met] == 200) > 10
    for name in ("t", "p", "p_error", "ng", "ns", "tangent", "uv", "origin"):
        assert np.isfinite(b[name][met]).all()
    for name in ("ng", "ns", "tangent"):
        assert np.abs(np.linalg.norm(b[name][met], axis=1) - 1).max() < 1e-6


def _permuted(rng: np.random.Generator, tree: Any, items: Any) -> None:
    """Children of every node in another order: another way of storing the same tree."""
    nodes = tree.arrays["nodes"]
    for node in nodes:
        order = rng.permutation(8)
        for name in ("lo_x", "hi_x", "lo_y", "hi_y", "lo_z", "hi_z", "child"):
            node[name] = node[name][order]
    packets = tree.arrays["packets"]
    for packet in packets:
        order = rng.permutation(8)
        for name in ("v0", "v1", "v2"):
            packet[name] = packet[name][:, order]
        packet["primitive"] = packet["primitive"][order]


@pytest.mark.parametrize("coincident", [True, False])
def test_hits_do_not_depend_on_the_order_of_storage(probe: Any, kit: Any, coincident: bool) -> None:
    rng = np.random.default_rng(2)
    if coincident:
        vertices, faces = (
            np.array([[-1, -1, 0.3], [1, -1, 0.1], [0, 1, 0.2]]),
            np.tile([0, 1, 2], (10_000, 1)),
        )
        faces = np.array([np.roll(f, i % 3) for i, f in enumerate(faces)])
    else:
        vertices, faces = _soup(rng, 3000)
    meshes = kit.Meshes()
    geometry = kit.compiled([meshes.add(vertices, faces)], meshes)
    rays = _random_rays(rng, kit, 4000)
    a = probe.trace(geometry, rays)
    for _ in range(3):
        _permuted(rng, geometry, None)
        assert _same(a, probe.trace(geometry, rays))
    assert np.count_nonzero(a["kind"] == kit.TRIANGLE) > 400


def test_of_coincident_faces_the_lowest_is_hit(probe: Any, kit: Any) -> None:
    rng = np.random.default_rng(3)
    meshes = kit.Meshes()
    corners = np.array([[-1, -1, 0.3], [1, -1, 0.1], [0, 1, 0.2]])
    geometry = kit.compiled([meshes.add(corners, np.tile([0, 1, 2], (10_000, 1)))], meshes)
    answers = probe.trace(geometry, _random_rays(rng, kit))
    met = answers["kind"] == kit.TRIANGLE
    assert np.count_nonzero(met) > RAYS // 10
    assert (answers["primitive"][met] == 0).all()


def test_both_builders_give_the_same_hits(probe: Any, kit: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from penumbra_kernels.accel import build

    rng = np.random.default_rng(4)
    vertices, faces = _soup(rng, 1500)
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
    vertices, faces = _soup(rng, 300)
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
    vertices, faces = _soup(rng, 100)
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


def test_nan_and_infinite_rays_miss_and_end_soon(probe: Any, kit: Any) -> None:
    rng = np.random.default_rng(7)
    vertices, faces = _soup(rng, 2000)
    meshes = kit.Meshes()
    shapes = [
        meshes.add(vertices, faces),
        {"type": "sphere"},
        {"type": "disc"},
        {"type": "plane", "point": [0, -3, 0]},
    ]
    geometry = kit.compiled(shapes, meshes)
    good = _random_rays(rng, kit)
    bad = good.copy()
    values = np.array([np.nan, np.inf, -np.inf], np.float32)
    bad[np.arange(RAYS), rng.integers(0, 6, RAYS)] = rng.choice(values, RAYS)
    bad[::100, 3:6] = 0.0
    bad[1::100] = good[1::100]
    bad[1::100, 6] = np.nan
    seconds = []
    for rays in (good, bad):
        runs = []
        for _ in range(5):
            start = time.perf_counter()
            answers = probe.trace(geometry, rays)
            runs.append(time.perf_counter() - start)
        seconds.append(min(runs))
    assert (answers["kind"] == kit.NONE).all()
    assert not answers["occluded"].any()
    assert seconds[1] <= 2.5 * seconds[0]


def test_nothing_is_met_behind_the_origin_or_beyond_tmax(probe: Any, kit: Any) -> None:
    rng = np.random.default_rng(8)
    vertices, faces = _soup(rng, 200)
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


def test_a_closed_shutter_gives_the_bits_of_the_still_scene(probe: Any, kit: Any) -> None:
    """Keyframes, and a shutter that opens and closes at one of them: exactly the scene with that
    transform."""
    rng = np.random.default_rng(9)
    vertices, faces = _soup(rng, 100)
    meshes = kit.Meshes()
    mesh = meshes.add(vertices, faces)
    at = [{"rotate": {"axis": [1, 2, 3], "angle": 77}}, {"translate": [0.1, 0.2, 0.3]}]
    later = [{"rotate": {"axis": [1, 0, 3], "angle": 17}}]
    keyframes = {"keyframes": [{"time": 1, "transform": at}, {"time": 2, "transform": later}]}
    bent = (vertices * 1.5).tolist()
    keys = [{"time": 1.0, "positions": vertices.tolist()}, {"time": 2.0, "positions": bent}]
    sphere = {"type": "sphere", "radius": 0.4}
    moving = kit.compiled(
        [{**mesh, "transform": keyframes}, {**sphere, "transform": keyframes}, {**mesh, "deformation": keys}],
        meshes,
        time=1.0,
    )
    still = kit.compiled([{**mesh, "transform": at}, {**sphere, "transform": at}, mesh], meshes, time=1.0)
    rays = _random_rays(rng, kit)
    assert len(moving.keyframes) == 0
    assert len(moving.arrays["times"]) == 0
    assert _same(probe.trace(moving, rays), probe.trace(still, rays))


def test_half_a_turn_over_the_shutter_keeps_the_object_whole(probe: Any, kit: Any) -> None:
    """A quad that turns by 180 degrees: at every instant a ray along its normal meets it at its center."""
    turns = [[{"rotate": {"axis": [0, 1, 0], "angle": a}}] for a in (0, 180)]
    keyframes = {"keyframes": [{"time": t, "transform": turns[t]} for t in (0, 1)]}
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 1}}
    geometry = kit.compiled([{"type": "quad", "transform": keyframes}], camera=camera)
    times = np.linspace(0, 1, 257).astype(np.float32)
    angle = np.pi * times.astype(np.float64)
    normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1)
    answers = probe.trace(geometry, kit.rays(normal * 3, -normal, time=times))
    assert (answers["kind"] == kit.TRIANGLE).all()
    assert np.abs(answers["t"] - 3).max() < 1e-6
    assert np.abs(answers["ng"] - normal).max() < 1e-6


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_an_instance_is_met_where_its_flattened_copy_is(probe: Any, kit: Any, scale: float) -> None:
    """Scaled, sheared, mirrored: the same t and normals as the mesh placed directly (hard case 15)."""
    rng = np.random.default_rng(10)
    vertices, faces = _soup(rng, 200)
    shear = [[-1, 0.5, 0, 1], [0, 1, 0.2, -2], [0, 0, 2, 3]]
    matrix = [[scale * x for x in row] for row in shear] + [[0, 0, 0, 1]]
    meshes = kit.Meshes()
    mesh = {**meshes.add(vertices, faces), "smooth": True}
    transform = [{"matrix": matrix}]
    placed = kit.compiled(
        [{"type": "instance", "prototype": "p", "transform": transform}], meshes, prototypes={"p": [mesh]}
    )
    direct = kit.compiled([{**mesh, "transform": transform}], meshes)
    center = scale * np.array([1.0, -2.0, 3.0])
    origins = center + kit.directions(rng, RAYS) * 6 * scale
    rays = kit.rays(origins, center + rng.uniform(-1, 1, (RAYS, 3)) * scale - origins)
    a, b = probe.trace(placed, rays), probe.trace(direct, rays)
    same = (a["primitive"] == b["primitive"]) & (a["kind"] == b["kind"])
    assert np.mean(same) > 0.999  # the rest pass so near to an edge that rounding decides
    met = same & (a["kind"] == kit.TRIANGLE)
    assert np.count_nonzero(met) > RAYS // 20
    cosine = np.abs(np.einsum("ij,ij->i", kit.unit(rays[:, 3:6]), b["ng"]))[met]
    # directions are some 6 scale long: t is near 1
    assert (np.abs(a["t"][met] - b["t"][met]) * cosine < 1e-5).all()
    assert np.abs(a["ng"] - b["ng"])[met].max() < 1e-4
    assert np.quantile(np.abs(a["ns"] - b["ns"])[met], 0.99) < 1e-4
