"""Hard cases 15-18: instances, motion, the shutter and the lens. Metres, seconds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from penumbra_kernels.compile.transforms import matrix_at
from penumbra_kernels.hardcases.benches import meshes
from penumbra_kernels.hardcases.benches.camera import Cameras, Motions, camera_of, keyed, random_u
from penumbra_kernels.hardcases.benches.geometry import (
    NONE,
    TRIANGLE,
    Meshes,
    Probe,
    compiled,
    directions,
    random_rays,
    rays,
    unit,
)
from penumbra_kernels.hardcases.case import HardCase, Measure, Workbench, at_least, at_most, enough, hard_case

HALF_TURN: Final = {"rotate": {"axis": [0, 1, 0], "angle": 180}}
SHEAR: Final = ((-1, 0.5, 0, 1), (0, 1, 0.2, -2), (0, 0, 2, 3))
"""Mirrors, shears and stretches."""


@hard_case(
    15,
    "instances",
    "Instances scaled by 1e-3 to 1e3, sheared and mirrored, are met where their flattened copies are.",
    oracle="the same triangles placed in float64: distance across the surface to 1e-5 of the ray, normals to 1e-4",
    algorithm="The object-space direction keeps its length, so that t is the world's; bounds transform too (pbrt-v4 6.8)",
)
def instances(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(10)
    n = bench.count(20_000, 300_000)
    vertices, faces = meshes.soup(rng, 200)
    probe = bench.get(Probe)
    for scale in (1e-3, 1.0, 1e3):
        matrix = [[scale * x for x in row] for row in SHEAR] + [[0, 0, 0, 1]]
        held = Meshes()
        mesh = {**held.add(vertices, faces), "smooth": True}
        transform = [{"matrix": matrix}]
        instance = {"type": "instance", "prototype": "p", "transform": transform}
        placed = compiled([instance], held, prototypes={"p": [mesh]})
        direct = compiled([{**mesh, "transform": transform}], held)
        center = scale * np.array([1.0, -2.0, 3.0])
        origins = center + directions(rng, n) * 6 * scale
        aimed = rays(origins, center + rng.uniform(-1, 1, (n, 3)) * scale - origins)
        a, b = probe.trace(placed, aimed), probe.trace(direct, aimed)
        same = (a["primitive"] == b["primitive"]) & (a["kind"] == b["kind"])
        yield at_most(
            f"other triangle met, scale {scale:g}", np.mean(~same), 1e-3
        )  # rays within rounding of an edge
        met = same & (a["kind"] == TRIANGLE)
        yield enough(f"hits, scale {scale:g}", np.count_nonzero(met), n // 20)
        cosine = np.abs(np.einsum("ij,ij->i", unit(aimed[:, 3:6]), b["ng"]))[met]
        error = np.abs(a["t"][met] - b["t"][met]) * cosine  # directions are some 6 scale long: t is near 1
        yield at_most(f"error across the surface over the ray, scale {scale:g}", error.max(), 1e-5)
        yield at_most(f"error of the normal, scale {scale:g}", np.abs(a["ng"] - b["ng"])[met].max(), 1e-4)


def _turned_quad(bench: Workbench) -> Iterator[Measure]:
    """A quad that turns by 180 degrees: at every instant a ray along its normal meets it at its centre."""
    keyframes = {"keyframes": [{"time": t, "transform": steps} for t, steps in ((0, []), (1, [HALF_TURN]))]}
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 1}}
    geometry = compiled([{"type": "quad", "transform": keyframes}], camera=camera)
    times = np.linspace(0, 1, 4097).astype(np.float32)
    angle = np.pi * times.astype(np.float64)
    normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1)
    answers = bench.get(Probe).trace(geometry, rays(normal * 3, -normal, time=times))
    yield at_most(
        "instants at which the turning quad is missed", np.count_nonzero(answers["kind"] != TRIANGLE), 0
    )
    yield at_most("error of its distance, of 3 metres", np.abs(answers["t"] - 3).max(), 1e-6)
    yield at_most("error of its normal", np.abs(answers["ng"] - normal).max(), 1e-6)


@hard_case(
    16,
    "half-turn",
    "Something turns by 180 degrees while the shutter is open: it keeps its size, and a moving camera sees the same.",
    oracle="M^T M = 1; a quad met at its centre at every instant; camera rays of the inverse motion in float64",
    algorithm="Rotation by slerp, stretch and translation apart (Shoemake and Duff 1992); boxes bound the arc's interval",
)
def half_turn(bench: Workbench) -> Iterator[Measure]:
    times = np.linspace(0, 1, 4097, dtype=np.float32)
    linear = (
        bench.get(Motions).matrices(keyed((0, []), (1, [HALF_TURN])), 1.0, times)[:, :, :3].astype(np.float64)
    )
    gram = np.einsum("nij,nik->njk", linear, linear)
    yield at_most("deviation of M^T M from 1", np.abs(gram - np.eye(3)).max(), 1e-6)
    yield from _turned_quad(bench)
    motion = keyed((0, []), (1, [HALF_TURN, {"translate": [1, 2, 3]}]))
    cameras, u = bench.get(Cameras), random_u(512)
    o, d, time = cameras(camera_of(transform=motion, shutter={"open": 0, "close": 1}), u)
    _, still, _ = cameras(camera_of(), u, motion=0)
    worst = 0.0
    for i in range(0, 512, 8):
        m = matrix_at(motion, float(time[i]))
        worst = max(worst, np.abs(d[i] - m[:3, :3] @ still[i]).max(), np.abs(o[i] - m[:3, 3]).max() / 3)
    yield at_most("rays of the moving camera against a moving world", worst, 2e-6)


@hard_case(
    17,
    "closed-shutter",
    "A shutter that opens and closes at one instant gives the still scene.",
    oracle="equal bits: geometry, and camera rays",
    algorithm="What does not move in the shutter's interval is compiled as still: there is no interval to divide by",
)
def closed_shutter(bench: Workbench) -> Iterator[Measure]:
    rng = np.random.default_rng(9)
    vertices, faces = meshes.soup(rng, 100)
    held = Meshes()
    mesh = held.add(vertices, faces)
    at = [{"rotate": {"axis": [1, 2, 3], "angle": 77}}, {"translate": [0.1, 0.2, 0.3]}]
    later = [{"rotate": {"axis": [1, 0, 3], "angle": 17}}]
    keyframes = {"keyframes": [{"time": 1, "transform": at}, {"time": 2, "transform": later}]}
    keys = [{"time": t, "positions": (vertices * size).tolist()} for t, size in ((1.0, 1.0), (2.0, 1.5))]
    sphere = {"type": "sphere", "radius": 0.4}
    moving: list[dict[str, Any]] = [
        {**mesh, "transform": keyframes},
        {**sphere, "transform": keyframes},
        {**mesh, "deformation": keys},
    ]
    still = compiled([{**mesh, "transform": at}, {**sphere, "transform": at}, mesh], held, time=1.0)
    aimed = random_rays(rng, 20_000)
    probe = bench.get(Probe)
    a, b = probe.trace(compiled(moving, held, time=1.0), aimed), probe.trace(still, aimed)
    yield at_most("hits that differ", np.count_nonzero(a != b), 0)
    yield enough("rays that met something", np.count_nonzero(b["kind"] != NONE), 1000)
    shutter = {"open": 0.25, "close": 0.25}
    look = {"look_at": {"origin": [1.0, 2.0, 5.0], "target": [0.5, 1.0, -2.0]}}
    motion = keyed((0, [look]), (1, [look, {"translate": [3, 0, 0]}]))
    frozen = camera_of(transform=[{"matrix": matrix_at(motion, 0.25).tolist()}], shutter=shutter)
    cameras = bench.get(Cameras)
    there = cameras(camera_of(transform=motion, shutter=shutter), random_u())
    here = cameras(frozen, random_u(), motion=0)
    yield at_most(
        "camera rays that differ",
        sum(int(np.count_nonzero(x != y)) for x, y in zip(there, here, strict=True)),
        0,
    )


@hard_case(
    18,
    "lens",
    "Apertures of 0 and 1e-8 metres, and a plane in focus a thousand kilometres away.",
    oracle="0: the pinhole's bits; else rays of float64, to 1e-5",
    algorithm="The direction is the pinhole's minus the lens offset over the focus distance: nothing large is subtracted",
)
def lens(bench: Workbench) -> Iterator[Measure]:
    cameras, u = bench.get(Cameras), random_u()
    different = 0
    for kind in ("perspective", "orthographic"):
        for focus in (1e-3, 1.0, 1e6):
            camera = camera_of(type=kind, lens={"aperture_radius": 0, "focus_distance": focus})
            for x, y in zip(cameras(camera, u), cameras(camera, u, lens=0), strict=True):
                different += int(np.count_nonzero(x != y))
    yield at_most("aperture 0: numbers unlike the pinhole's", different, 0)
    across = np.stack(
        [2 * u[:, 0].astype(float) - 1, 1 - 2 * u[:, 1].astype(float), -np.ones(len(u))], axis=1
    )
    for aperture, focus in ((1e-8, 1.0), (0.05, 1e6), (0.05, 3.0), (10.0, 1e6)):
        o, d, _ = cameras(camera_of(fov=90, lens={"aperture_radius": aperture, "focus_distance": focus}), u)
        name = f"aperture {aperture:g} m, focus {focus:g} m"
        yield at_most(
            f"error of the direction, {name}", np.abs(unit(d) - unit(across * focus - o)).max(), 1e-5
        )
        radii = np.hypot(o[:, 0], o[:, 1])
        yield at_most(f"largest lens radius over the aperture, {name}", radii.max() / aperture, 1 + 2.0**-22)
        yield at_least(f"largest lens radius over the aperture, {name}", radii.max() / aperture, 0.95)


CASES: Final[tuple[HardCase, ...]] = (instances, half_turn, closed_shutter, lens)
