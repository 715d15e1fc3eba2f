"""Hard cases 4-7, 10: rays that leave a surface neither meet it again nor pass through what it closes off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels.hardcases.benches import meshes
from penumbra_kernels.hardcases.benches.geometry import (
    NONE,
    SPHERE,
    TRIANGLE,
    Probe,
    compiled,
    compiled_mesh,
    directions,
    rays,
    unit,
)
from penumbra_kernels.hardcases.case import HardCase, Measure, Workbench, at_most, enough, hard_case

SPAWNING: Final = (
    "Each primitive bounds its point's rounding error; spawned rays start outside that box (pbrt-v4 6.8.6)"
)


def leaving(answers: Any, rng: np.random.Generator, side: float, time: Any = 0.0) -> NDArray[np.float32]:
    """Rays from the answers' spawned origins into the hemisphere of side * ng, every second one grazing."""
    normals = answers["ng"].astype(np.float64) * side
    d = directions(rng, len(answers))
    d[::2] -= 0.999 * np.einsum("ij,ij->i", d, normals)[::2, None] * normals[::2]
    d = unit(d)
    d *= np.where(np.einsum("ij,ij->i", d, normals) < 0, -1.0, 1.0)[:, None]
    return rays(answers["origin"], d, time=time)


def _offsets(size: float, offsets: tuple[float, ...]) -> Iterator[float]:
    """Those at which an object of this size is larger than the spacing of floats."""
    return (offset for offset in offsets if size >= 1e-6 * offset)


def _met_again(
    bench: Workbench, geometry: Any, aimed: Any, side: float, rng: np.random.Generator
) -> tuple[int, int]:
    """(hits, rays leaving them that met anything) in a scene of one convex or flat thing."""
    probe = bench.get(Probe)
    answers = probe.trace(geometry, aimed, side)
    hit = answers[answers["kind"] != NONE]
    again = probe.trace(geometry, leaving(hit, rng, side))
    return len(hit), int(np.count_nonzero((again["kind"] != NONE) | (again["occluded"] != 0)))


def _triangle_again(bench: Workbench, size: float, offset: float, side: float, n: int) -> tuple[int, int]:
    rng = np.random.default_rng(5)
    total = [0, 0]
    for _ in range(4):
        corners = rng.normal(size=(3, 3)) * size + offset * directions(rng, 1)
        geometry = compiled_mesh(corners, [[0, 1, 2]])
        targets = rng.dirichlet((1, 1, 1), n // 4) @ geometry.arrays["positions"].astype(np.float64)
        origins = targets + directions(rng, len(targets)) * size * 3
        for k, count in enumerate(_met_again(bench, geometry, rays(origins, targets - origins), side, rng)):
            total[k] += count
    return total[0], total[1]


def _round_again(bench: Workbench, kind: str, size: float, offset: float, n: int) -> tuple[int, int]:
    rng = np.random.default_rng(6)
    center = [float(x) for x in directions(rng, 1)[0] * offset]
    models: dict[str, dict[str, Any]] = {
        "sphere": {"type": "sphere", "center": center, "radius": size},
        "disc": {"type": "disc", "center": center, "normal": [0.3, 0.5, 0.7], "radius": size},
        "plane": {"type": "plane", "point": center, "normal": [0.3, 0.5, 0.7]},
    }
    targets = np.asarray(center) + rng.normal(size=(n, 3)) * size * 0.3
    origins = targets + directions(rng, n) * 4 * size
    return _met_again(bench, compiled([models[kind]]), rays(origins, targets - origins), 1.0, rng)


def _needle_again(bench: Workbench, thin: float, offset: float, n: int) -> tuple[int, int]:
    """Rays along a needle: edge functions whose relative error is not small let thousands of them meet it again."""
    rng = np.random.default_rng(11)
    probe = bench.get(Probe)
    total = [0, 0]
    for _ in range(3):
        along, across = directions(rng, 2)
        start = rng.normal(size=3) + offset * directions(rng, 1)[0]
        corners = np.array([start, start + along, start + 0.4 * along + thin * across])
        geometry = compiled_mesh(corners, [[0, 1, 2]])
        targets = rng.dirichlet((1, 1, 1), n) @ geometry.arrays["positions"].astype(np.float64)
        origins = targets + directions(rng, len(targets)) * 2
        answers = probe.trace(geometry, rays(origins, targets - origins), 1.0)
        hit = answers[answers["kind"] == TRIANGLE]
        again = leaving(hit, rng, 1.0)
        d = 1e-3 * directions(rng, len(hit)) + along * rng.choice([-1, 1], len(hit))[:, None]
        d *= np.where(np.einsum("ij,ij->i", d, hit["ng"]) < 0, -1.0, 1.0)[:, None]
        again[::3, 3:6] = d[::3]
        total[0] += len(hit)
        total[1] += int(np.count_nonzero(probe.trace(geometry, again)["kind"] != NONE))
    return total[0], total[1]


@hard_case(
    4,
    "self-hit",
    "A ray never meets the triangle, sphere, disc, plane or needle that it leaves, from a millionth to a million metres.",
    oracle="nothing else is there: any hit is a self-hit",
    algorithm=SPAWNING,
)
def self_hit(bench: Workbench) -> Iterator[Measure]:
    n = bench.count(4_000, 40_000)
    for kind, sizes, offsets in (
        ("triangle", (1e-6, 1e-3, 1.0, 1e2, 1e4), (0.0, 1.0, 1e6)),
        ("sphere", (1e-6, 1e-2, 1.0, 1e3, 1e6), (0.0, 10.0, 1e4)),
        ("disc", (1e-6, 1e-2, 1.0, 1e3, 1e6), (0.0, 10.0, 1e4)),
        ("plane", (1e-6, 1e-2, 1.0, 1e3, 1e6), (0.0, 10.0, 1e4)),
        ("needle", (1e-2, 1e-4, 1e-6), (0.0, 10.0)),
    ):
        hits = again = 0
        for size in sizes:
            for offset in _offsets(1.0 if kind == "needle" else size, offsets):
                if kind == "triangle":
                    counts = [_triangle_again(bench, size, offset, side, n) for side in (1.0, -1.0)]
                elif kind == "needle":
                    counts = [_needle_again(bench, size, offset, n)]
                else:
                    counts = [_round_again(bench, kind, size, offset, n)]
                hits += sum(c[0] for c in counts)
                again += sum(c[1] for c in counts)
        yield at_most(f"self-hits, {kind}, of {hits}", again, 0)
        yield enough(f"rays that left a {kind}", hits, 0.5 * n)


def _box_leaks(bench: Workbench, size: float, offset: float, far: float, n: int) -> int:
    """Rays lost in four bounces from wall to wall. offset: from the anchor; far: of the anchor from the scene's origin."""
    rng = np.random.default_rng(9)
    unscaled, faces = meshes.box()
    corners = unscaled * size + offset
    geometry = compiled_mesh(corners + far, faces, (far, far, far))
    start = (rng.uniform(0.2, 0.8, (n, 3)) * size + offset).astype(np.float32)
    d = directions(rng, n)
    inside = 0.5 * (corners[0] + corners[-1])
    lost = 0
    for _ in range(4):
        answers = bench.get(Probe).trace(geometry, rays(start, d), 1.0)
        inwards = np.einsum("ij,ij->i", answers["ng"], inside - answers["p"]) > 0
        lost += int(np.count_nonzero((answers["kind"] == NONE) | (inwards != inwards[0])))
        start, d = answers["origin"], directions(rng, n)
        n_inside = answers["ng"].astype(np.float64)
        d *= np.where(np.einsum("ij,ij->i", d, n_inside) < 0, -1.0, 1.0)[:, None]
    return lost


@hard_case(
    5,
    "object-far-away",
    "A closed box far from the camera, or far from the scene's origin with the camera beside it, leaks nothing.",
    oracle="a furnace of rays: each of four bounces meets a wall",
    algorithm=SPAWNING + "; positions relative to the camera's place, subtracted in float64",
)
def object_far_away(bench: Workbench) -> Iterator[Measure]:
    n = bench.count(10_000, 100_000)
    for size, offset, far in (
        (1.0, 0.0, 1e6),
        (1.0, 0.0, 1e9),
        (1.0, 1e3, 0.0),
        (1.0, 1e4, 0.0),
        (1.0, 1e4, 1e6),
    ):
        name = f"{offset:g} from the camera, {far:g} from the origin"
        yield at_most(f"leaks of a unit box {name}", _box_leaks(bench, size, offset, far, n), 0)


@hard_case(
    6,
    "tiny-object",
    "A box of a millionth of a metre, or of ten kilometres, is as tight as one of a metre, and looks the same.",
    oracle="no leak; distances in units of its size as those of the unit box, to 1e-5",
    algorithm=SPAWNING + ": no length is a constant",
)
def tiny_object(bench: Workbench) -> Iterator[Measure]:
    n = bench.count(10_000, 100_000)
    unscaled, faces = meshes.box()
    rng = np.random.default_rng(12)
    origins, d = rng.uniform(0.2, 0.8, (n, 3)), directions(rng, n)
    seen = {}
    for size in (1.0, 1e-6, 1e4):
        yield at_most(f"leaks, size {size:g}", _box_leaks(bench, size, 0.0, 0.0, n), 0)
        geometry = compiled_mesh(unscaled * size, faces)
        seen[size] = bench.get(Probe).trace(geometry, rays(origins * size, d))["t"].astype(np.float64) / size
    for size in (1e-6, 1e4):
        yield at_most(
            f"relative change of distances, size {size:g}", np.abs(seen[size] / seen[1.0] - 1).max(), 1e-5
        )


@hard_case(
    7,
    "nested-layers",
    "Of two spheres whose radii differ by 4e-5, the ray that enters the outer one meets the inner one next.",
    oracle="both met, by every ray",
    algorithm=SPAWNING,
)
def nested_layers(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(10)
    geometry = compiled([{"type": "sphere"}, {"type": "sphere", "radius": 1.0 + 4e-5}])
    origins = directions(rng, 100_000) * 3
    probe = bench.get(Probe)
    answers = probe.trace(geometry, rays(origins, -origins), -1.0)
    again = probe.trace(geometry, rays(answers["origin"], -origins))
    yield at_most("outer sphere missed", np.count_nonzero(answers["primitive"] != 1), 0)
    yield at_most("inner sphere missed", np.count_nonzero(again["primitive"] != 0), 0)


@hard_case(
    10,
    "inside-a-sphere",
    "A ray that starts on a sphere and goes inwards, at any angle, comes out at the far side.",
    oracle="the chord in float64, 2 r cos for a start on the sphere, to 1e-5",
    algorithm="Quadratic without cancellation: the root of larger size first, the other as their product over it",
)
def inside_a_sphere(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(7)
    n = bench.count(30_000, 300_000)
    probe = bench.get(Probe)
    for size in (1e-6, 1.0, 1e3):
        geometry = compiled([{"type": "sphere", "radius": size}])
        origins = directions(rng, n) * 4 * size
        answers = probe.trace(geometry, rays(origins, rng.normal(size=(n, 3)) * 0.3 * size - origins), -1.0)
        inside = leaving(answers[answers["kind"] != NONE], rng, -1.0)
        again = probe.trace(geometry, inside)
        o, d = inside[:, :3].astype(np.float64), inside[:, 3:6].astype(np.float64)
        a, b = np.einsum("ij,ij->i", d, d), np.einsum("ij,ij->i", o, d)
        beyond = np.einsum("ij,ij->i", o, o) - float(np.float32(size)) ** 2
        chord = (-b + np.sqrt(b * b - a * beyond)) / a
        yield at_most(f"missed, radius {size:g}", np.count_nonzero(again["kind"] != SPHERE), 0)
        yield at_most(
            f"relative error of the chord, radius {size:g}", np.abs(again["t"] / chord - 1).max(), 1e-5
        )


CASES: Final[tuple[HardCase, ...]] = (self_hit, object_far_away, tiny_object, nested_layers, inside_a_sphere)
