"""Hard cases 1-3, 8, 9, 11-14: meeting triangles and spheres. Metres, relative to the camera's anchor."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene
from pydantic import ValidationError

from penumbra_kernels.assets import AssetError
from penumbra_kernels.hardcases.benches import meshes
from penumbra_kernels.hardcases.benches.arithmetic import Arithmetic
from penumbra_kernels.hardcases.benches.geometry import (
    NONE,
    SPHERE,
    TRIANGLE,
    Meshes,
    Probe,
    compiled,
    compiled_mesh,
    directions,
    random_rays,
    rays,
    unit,
)
from penumbra_kernels.hardcases.case import HardCase, Measure, Workbench, at_most, enough, hard_case

WATERTIGHT: Final = (
    "Watertight edge functions (Woop, Benthin, Wald 2013), their signs exact (Jeannerod, Louvet, Muller 2013); "
    "boxes widened by what their own test errs"
)


def rounded(points: Any) -> NDArray[np.float64]:
    """Points that float32 holds."""
    return np.asarray(points).astype(np.float32).astype(np.float64)


def _at_a_diagonal(bench: Workbench, center: Any, half: float) -> tuple[float, float]:
    """Shares of rays aimed at a quad's diagonal that miss it, and that meet it once more when they go on behind it.

    A ray whose edge function is exactly 0 is inside both triangles; of two hits at one t the first triangle's counts.
    What can go wrong is a path that passes through the surface and meets the second triangle after the first.
    """
    rng = np.random.default_rng(1)
    n = bench.count(200_000, 1_000_000)
    c = np.asarray(center)
    geometry = compiled_mesh(*meshes.quad(center, half))
    s = rng.uniform(-0.99, 0.99, n) * half
    targets = c + np.stack([s, s, 0 * s], 1)
    origins = rounded(c + np.array([0, 0, 10 * half]) + rng.uniform(-half, half, (n, 3)))
    aimed = rays(origins, targets - origins)
    probe = bench.get(Probe)
    answers = probe.trace(geometry, aimed, -1.0)
    met = answers["kind"] == TRIANGLE
    onwards = aimed[met].copy()
    onwards[:, :3] = answers["origin"][met]
    again = probe.trace(geometry, onwards)["kind"] == TRIANGLE
    return float(np.mean(~met)), float(np.mean(again))


QUADS: Final = {
    "at z = 5": ((0.0, 0.0, 5.0), 2.0),
    "0.27 million metres away": ((148376.0, 1234.0, -223423.0), 2.0),
}


@hard_case(
    1,
    "shared-edge",
    "Rays aimed at the edge that two triangles share meet exactly one of them.",
    oracle="exactly one hit: no ray misses, at most 1e-4 meet the other one when they go on behind the surface",
    algorithm=WATERTIGHT,
)
def shared_edge(bench: Workbench) -> Iterator[Measure]:
    for name, (center, half) in QUADS.items():
        misses, doubles = _at_a_diagonal(bench, center, half)
        yield at_most(f"misses, quad {name}", misses, 0)
        yield at_most(f"doubles, quad {name}", doubles, 1e-4)


@hard_case(
    2,
    "contraction",
    "With the options that every program is built with, the compiler fuses no product with a sum.",
    oracle="float32 arithmetic of numpy, bit for bit; then as case 1",
    algorithm="`#pragma OPENCL FP_CONTRACT OFF` heads every program, no fast-math option; FMA() where fusing is wanted",
)
def contraction(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(2)
    a, b, c, d = (rng.normal(size=bench.count(200_000, 1_000_000)).astype(np.float32) for _ in range(4))
    arithmetic = bench.get(Arithmetic)
    yield at_most("a * b + c that differ", np.mean(arithmetic("sum", a, b, c, d) != a * b + c), 0)
    yield at_most("a * b - c * d that differ", np.mean(arithmetic("cross", a, b, c, d) != a * b - c * d), 0)
    # The bounds of OpenCL 1.2, table 7.4; correct rounding would be half a unit.
    yield at_most(
        "error of quotients, ulp", _ulps(arithmetic("quotient", a, b, c, d), a.astype(float) / b), 2.5
    )
    yield at_most(
        "error of square roots, ulp",
        _ulps(arithmetic("root", a, b, c, d), np.sqrt(np.abs(a.astype(float)))),
        3,
    )
    misses, _ = _at_a_diagonal(bench, *QUADS["at z = 5"])
    yield at_most("misses, quad at z = 5", misses, 0)


def _ulps(got: NDArray[Any], exact: NDArray[Any]) -> float:
    return float((np.abs(got - exact) / np.spacing(np.abs(exact).astype(np.float32))).max())


@hard_case(
    3,
    "shared-vertex",
    "Rays aimed at the vertices and edges of a closed mesh from inside it never get out, whatever its size.",
    oracle="no miss",
    algorithm=WATERTIGHT,
)
def shared_vertex(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(3)
    n = bench.count(100_000, 1_000_000)
    unscaled, faces = meshes.sphere(16)
    for scale in (1e-6, 1.0, 1e4):
        vertices = rounded(unscaled * scale)
        geometry = compiled_mesh(vertices, faces)
        face = faces[rng.integers(0, len(faces), n)]
        for target, along in (("vertices", np.zeros((n, 1))), ("edges", rng.random((n, 1)))):
            targets = vertices[face[:, 0]] * (1 - along) + vertices[face[:, 1]] * along
            origins = rounded(rng.uniform(-0.4, 0.4, (n, 3)) * scale)
            answers = bench.get(Probe).trace(geometry, rays(origins, targets - origins))
            lost = (answers["kind"] == NONE) | (answers["occluded"] == 0)
            yield at_most(f"misses at {target}, radius {scale:g}", np.mean(lost), 0)


@hard_case(
    8,
    "far-sphere",
    "A unit sphere seen from a thousand and from ten thousand radii: rays near its limb meet it or not as they should.",
    oracle="distance of the ray from the centre in float64; shares of rays on the wrong side",
    algorithm="Discriminant from the remainder of projecting the centre on the ray (Haines, Gunther, Akenine-Moller 2019)",
)
def far_sphere(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(4)
    geometry = compiled([{"type": "sphere"}])
    n = bench.count(100_000, 1_000_000)
    for distance, wrong in ((1e3, 1e-4), (1e4, 1e-3)):
        impact, angle = rng.uniform(0.9, 1.1, n), rng.uniform(0, 2 * np.pi, n)
        targets = np.stack([impact * np.cos(angle), impact * np.sin(angle), 0 * angle], 1)
        aimed = rays(np.broadcast_to([0.0, 0.0, distance], targets.shape), targets - [0, 0, distance])
        aimed[:, 3:6] = unit(aimed[:, 3:6])
        o, d = aimed[:, :3].astype(np.float64), aimed[:, 3:6].astype(np.float64)
        closest = np.linalg.norm(np.cross(o, d), axis=1) / np.linalg.norm(d, axis=1)
        met = bench.get(Probe).trace(geometry, aimed)["kind"] == SPHERE
        yield at_most(f"misjudged from {distance:g}", np.mean(met != (closest <= 1.0)), wrong)


@hard_case(
    9,
    "planet-underfoot",
    "A planet of a million metres with the eye one metre above it, and a sun near the horizon: no acne, no banding.",
    oracle="closed form of t in float64: 4 ulp of the distance to the centre over the cosine; no ground shadows itself",
    algorithm="Precise discriminant, hits put back on the sphere (Haines et al. 2019), bounds for spawning (pbrt-v4 6.8)",
)
def planet_underfoot(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(5)
    yield from _on_a_planet(bench, np.array([0.0, 1.0, 0.0]), "at the pole")
    for number, up in enumerate(directions(rng, bench.count(2, 16)), start=1):
        yield from _on_a_planet(bench, up, f"at place {number}")


def _on_a_planet(bench: Workbench, up: NDArray[np.float64], where: str) -> Iterator[Measure]:
    rng = np.random.default_rng(5)
    n, r = bench.count(50_000, 500_000), 1e6
    center = -up * (r + 1)
    geometry = compiled([{"type": "sphere", "center": center.tolist(), "radius": r}])
    east = unit(np.cross(up, [0.6, 0.0, 0.8]))
    north = np.cross(up, east)
    down = np.exp(rng.uniform(np.log(2e-3), 0, n))[:, None]
    angle = rng.uniform(0, 2 * np.pi, (n, 1))
    seen = rays(
        np.zeros((n, 3)), np.sqrt(1 - down**2) * (np.cos(angle) * east + np.sin(angle) * north) - down * up
    )
    d = seen[:, 3:6].astype(np.float64)
    a, b, c = np.einsum("ij,ij->i", d, d), -(d @ center), center @ center - r**2
    root = np.sqrt(b * b - a * c)
    probe = bench.get(Probe)
    answers = probe.trace(geometry, seen)
    yield at_most(f"rays that miss the ground, {where}", np.mean(answers["kind"] != SPHERE), 0)
    error = np.abs(answers["t"] - (-b - root) / a) * root / r
    yield at_most(
        f"error of t over the cosine, ulp of the radius, {where}", (error / (2.0**-24 * r)).max(), 4
    )
    sun = np.broadcast_to(unit(east + 0.01 * up), d.shape)
    shadowed = probe.trace(geometry, rays(answers["origin"], sun))["occluded"]
    yield at_most(f"ground in its own shadow, {where}", np.mean(shadowed != 0), 0)


@hard_case(
    11,
    "needle",
    "Needles a millionth as wide as long, triangles without area and doubled vertices disturb nothing.",
    oracle="no NaN, unit normals, every hit as without the degenerate triangles, bit for bit",
    algorithm="Triangles without area are never met; normals from cross products of edges scaled to the largest",
)
def needle(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(6)
    n = bench.count(20_000, 300_000)
    vertices, faces = meshes.soup(rng, 200)
    thin = np.array([[-1, 0.1, 0], [1, 0.1, 0], [0, 0.1 + 1e-6, 0]])
    flat = np.array([[-1, 0, 0], [0, 0, 0], [1, 0, 0]])
    clean, dirty = Meshes(), Meshes()
    good = compiled([clean.add(np.concatenate([vertices, thin]), [*faces, [600, 601, 602]])], clean)
    bad_faces = [*faces, [600, 601, 602], [603, 604, 605], [0, 0, 1], [5, 5, 5]]
    bad = compiled([dirty.add(np.concatenate([vertices, thin, flat]), bad_faces)], dirty)
    aimed = random_rays(rng, n)
    aimed[::10, 3:6] = np.float32(thin[0] + rng.random((n // 10, 1)) * (thin[1] - thin[0])) - aimed[::10, :3]
    probe = bench.get(Probe)
    a, b = probe.trace(good, aimed), probe.trace(bad, aimed)
    yield at_most("hits changed by degenerate triangles", np.mean(a != b), 0)
    met = b[b["kind"] == TRIANGLE]
    yield enough("hits of the needle", np.count_nonzero(met["primitive"] == 200), 10)
    fields = ("t", "p", "p_error", "ng", "ns", "tangent", "uv", "origin")
    yield at_most(
        "values not finite", sum(int(np.count_nonzero(~np.isfinite(met[name]))) for name in fields), 0
    )
    lengths = np.stack([np.linalg.norm(met[name], axis=1) for name in ("ng", "ns", "tangent")])
    yield at_most("error of the normals' length", np.abs(lengths - 1).max(), 1e-6)


def permute_storage(rng: np.random.Generator, tree: Any) -> None:
    """Put the children of every node and the lanes of every packet into another order, in copies: a tree from the cache cannot
    be written to."""
    for name in ("nodes", "packets"):
        tree.arrays[name] = tree.arrays[name].copy()
    for node in tree.arrays["nodes"]:
        order = rng.permutation(8)
        for name in ("lo_x", "hi_x", "lo_y", "hi_y", "lo_z", "hi_z", "child"):
            node[name] = node[name][order]
    for packet in tree.arrays["packets"]:
        used = int(np.argmax(packet["primitive"] == packet["primitive"][-1])) + 1
        order = rng.permutation(used)
        order = np.append(order, np.full(8 - used, order[-1]))  # a packet ends by repeating its last triangle
        for name in ("v0", "v1", "v2"):
            packet[name] = packet[name][:, order]
        packet["primitive"] = packet["primitive"][order]


@hard_case(
    12,
    "coincident-faces",
    "Of ten thousand faces in one place, and in any scene, what is hit does not depend on how the tree is stored.",
    oracle="equal bits after permuting nodes and packets; of coincident faces the first",
    algorithm="Equal t goes to the lowest primitive, in packets and between them",
)
def coincident_faces(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(7)
    probe = bench.get(Probe)
    corners = np.array([[-1, -1, 0.3], [1, -1, 0.1], [0, 1, 0.2]])
    alike = np.tile([0, 1, 2], (10_000, 1))
    turned = np.array([np.roll(f, i % 3) for i, f in enumerate(alike)])
    aimed = random_rays(rng, bench.count(4000, 40_000))
    for name, (vertices, faces) in {
        "10,000 faces in one place": (corners, turned),
        "3,000 scattered faces": meshes.soup(rng, 3000),
    }.items():
        geometry = compiled_mesh(vertices, faces)
        before = probe.trace(geometry, aimed)
        changed = 0
        for _ in range(3):
            permute_storage(rng, geometry)
            changed += int(np.count_nonzero(probe.trace(geometry, aimed) != before))
        yield at_most(f"hits changed, {name}", changed, 0)
    answers = probe.trace(compiled_mesh(corners, alike), aimed)
    met = answers[answers["kind"] == TRIANGLE]
    yield enough("rays that met the first of 10,000", len(met), len(aimed) // 20)
    yield at_most("rays that met another", np.count_nonzero(met["primitive"] != 0), 0)


@hard_case(
    13,
    "axis-parallel",
    "Directions with zeros of either sign, origins in the planes of boxes, rays along edges of an axis-parallel grid.",
    oracle="the triangle that brute force finds first at each grid point; no ray slips through",
    algorithm="Slab test whose far plane is widened by its rounding (Ize 2013); 0 * inf never decides",
)
def axis_parallel(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(8)
    n = bench.count(60_000, 600_000)
    probe = bench.get(Probe)
    vertices, faces = meshes.grid(8)
    k = rng.integers(0, 9, (n // 3, 2)) / 4.0 - 1.0
    origins = np.concatenate([k, np.full((len(k), 1), 1.0)], 1)
    zeros = np.where(rng.random((len(k), 2)) < 0.5, -0.0, 0.0)
    straight = rays(origins, np.concatenate([zeros, np.full((len(k), 1), -1.0)], 1))
    answers = probe.trace(compiled_mesh(vertices, faces), straight)
    touching = np.full((9, 9), len(faces))
    for number, face in enumerate(faces):
        for vertex in face:
            at = divmod(int(vertex), 9)
            touching[at] = min(touching[at], number)
    index = np.round((k + 1) * 4).astype(int)
    wrong = (answers["t"] != 1.0) | (answers["primitive"] != touching[index[:, 0], index[:, 1]])
    yield at_most("hits unlike brute force's", np.mean(wrong), 0)
    vertices, faces = meshes.grid(32)
    geometry = compiled_mesh(vertices + 0.1, faces)
    for distance in (1e-3, 3.0, 1e3):
        answers = probe.trace(geometry, _at_grid_lines(rng, n, distance))
        yield at_most(f"rays through the edges from {distance:g}", np.mean(answers["kind"] == NONE), 0)


def _at_grid_lines(rng: np.random.Generator, n: int, distance: float) -> NDArray[np.float32]:
    """Rays aimed at lines and vertices of grid(32) + 0.1, a quarter of them in a line's own plane."""
    targets = rng.uniform(-0.95, 0.95, (n, 3))
    targets[:, 2] = 0.0
    on_line = np.round((targets + 1) * 16) / 16 - 1
    axis = rng.integers(0, 3, n)
    targets[:, 0] = np.where(axis != 1, on_line[:, 0], targets[:, 0])
    targets[:, 1] = np.where(axis != 0, on_line[:, 1], targets[:, 1])
    targets = targets + 0.1
    away = rng.normal(size=(n, 3)) * distance
    away[:, 2] = np.abs(away[:, 2]) + 0.1 * distance
    away[: n // 4, 0] = 0.0
    origins = rounded(targets + away)
    return rays(origins, targets - origins)


@hard_case(
    14,
    "nan-and-infinity",
    "NaN and infinite rays meet nothing and take no longer; broken vertices and transforms are refused by name.",
    oracle="a miss; time at most 2.5 times that of good rays; AssetError or a validation error",
    algorithm="Comparisons that NaN fails, and finite checks where meshes and scenes come in",
)
def nan_and_infinity(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(9)
    n = bench.count(20_000, 100_000)
    held = Meshes()
    shapes = [held.add(*meshes.soup(rng, 2000)), {"type": "sphere"}, {"type": "disc"}]
    geometry = compiled([*shapes, {"type": "plane", "point": [0, -3, 0]}], held)
    good = random_rays(rng, n)
    bad = good.copy()
    bad[np.arange(n), rng.integers(0, 6, n)] = rng.choice([np.nan, np.inf, -np.inf], n)
    bad[::100, 3:6] = 0.0
    bad[1::100] = good[1::100]
    bad[1::100, 6] = np.nan
    probe = bench.get(Probe)
    seconds: dict[str, list[float]] = {"good": [], "bad": []}
    for _ in range(5):
        for name, some in (("good", good), ("bad", bad)):
            start = time.perf_counter()
            answers = probe.trace(geometry, some)
            seconds[name].append(time.perf_counter() - start)
    met = (answers["kind"] != NONE) | (answers["occluded"] != 0)
    yield at_most("hits of broken rays", np.mean(met), 0)
    yield at_most("time of broken over good rays", min(seconds["bad"]) / min(seconds["good"]), 2.5)
    yield at_most("broken meshes and transforms accepted", _accepted_in_error(), 0)


def _accepted_in_error() -> int:
    accepted = 0
    for value in (np.nan, np.inf, 1e30):
        try:
            compiled_mesh([[0, 0, 0], [1, 0, 0], [0, value, 0]], [[0, 1, 2]])
            accepted += 1
        except AssetError:
            pass
    for step in (
        {"translate": [np.nan, 0, 0]},
        {"scale": np.inf},
        {"rotate": {"axis": [0, 0, 0], "angle": 1}},
    ):
        shape = {"type": "sphere", "transform": [step]}
        try:
            Scene.model_validate({"version": 1, "camera": {"type": "perspective"}, "shapes": [shape]})
            accepted += 1
        except ValidationError:
            pass
    return accepted


CASES: Final[tuple[HardCase, ...]] = (
    shared_edge,
    contraction,
    shared_vertex,
    far_sphere,
    planet_underfoot,
    needle,
    coincident_faces,
    axis_parallel,
    nan_and_infinity,
)
