"""Random scenes of everything there is against brute force in float64 (hard cases 15, 16, and every
primitive)."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.geometry import compile_geometry
from penumbra_scene.scene import Scene

_spec = importlib.util.spec_from_file_location("geometry_oracle", Path(__file__).with_name("oracle.py"))
assert _spec is not None
assert _spec.loader is not None
oracle: Any = importlib.util.module_from_spec(_spec)
sys.modules[_spec.name] = oracle
_spec.loader.exec_module(oracle)

RAYS = 4096
SHUTTER = (0.25, 0.75)
FRAME = 10.0
SCENE_ROUNDING = 12.0 * 2.0**-22
"""Metres: four ulp of the scene's size."""


def _vector(rng: np.random.Generator, size: float = 1.0) -> list[float]:
    return [float(x) for x in rng.uniform(-size, size, 3)]


def _steps(rng: np.random.Generator, size: float, stretch: bool) -> list[Any]:
    steps: list[Any] = []
    if stretch:
        steps.append({"scale": [float(x) for x in rng.uniform(0.4, 1.6, 3) * rng.choice([-1, 1], 3)]})
    else:
        steps.append({"scale": float(rng.uniform(0.4, 1.6))})
    steps.append(
        {"rotate": {"axis": [float(x) for x in rng.normal(size=3)], "angle": float(rng.uniform(-180, 180))}}
    )
    if stretch and rng.random() < 0.5:
        steps.append({"scale": [float(x) for x in rng.uniform(0.5, 2.0, 3)]})
    steps.append({"translate": _vector(rng, size)})
    return steps


def _transform(rng: np.random.Generator, kind: str, size: float = 5.0) -> Any:
    if kind == "still":
        return _steps(rng, size, False)
    if kind == "stretched":
        return _steps(rng, size, True)
    times = [FRAME - 1.0, FRAME + 0.4, FRAME + 0.6, FRAME + 2.0]
    if kind == "sliding":
        same = _steps(rng, size, True)
        return {
            "keyframes": [
                {"time": t, "transform": [*same, {"translate": _vector(rng, 0.5 * size)}]} for t in times
            ]
        }
    stretch = kind == "moving stretched"
    return {"keyframes": [{"time": t, "transform": _steps(rng, size, stretch)} for t in times]}


def _mesh(rng: np.random.Generator, deform: bool, size: float = 1.0) -> dict[str, Any]:
    n = 12
    points = [_vector(rng, size) for _ in range(n)]
    faces = [[int(i) for i in rng.choice(n, 3, replace=False)] for _ in range(24)]
    mesh: dict[str, Any] = {"type": "mesh", "positions": points, "indices": faces}
    if deform:
        mesh["deformation"] = [
            {"time": t, "positions": [_vector(rng, size) for _ in range(n)]}
            for t in (FRAME, FRAME + 0.5, FRAME + 1)
        ]
    return mesh


def _shape(rng: np.random.Generator, kind: str, deform: bool) -> dict[str, Any]:
    which = rng.integers(0, 4)
    shapes: list[dict[str, Any]] = [
        {"type": "sphere", "center": _vector(rng, 0.5), "radius": float(rng.uniform(0.3, 1))},
        {
            "type": "disc",
            "center": _vector(rng, 0.5),
            "normal": _vector(rng),
            "radius": float(rng.uniform(0.3, 1)),
        },
        {"type": "quad", "origin": _vector(rng), "u": _vector(rng), "v": _vector(rng)},
        _mesh(rng, deform),
    ]
    return {**shapes[which], "transform": _transform(rng, kind)}


def _scene(seed: int, kind: str, deform: bool, instances: bool, planes: bool) -> Scene:
    rng = np.random.default_rng(seed)
    shapes = [_shape(rng, kind, deform) for _ in range(24)]
    prototypes: dict[str, Any] = {}
    if instances:
        prototypes["a"] = [_shape(rng, "still", deform) for _ in range(4)]
        prototypes["b"] = [_shape(rng, kind, deform) for _ in range(4)]
        for p in prototypes.values():
            for model in p:
                if isinstance(model["transform"], dict):
                    continue
                model["transform"].append({"scale": 0.3})
        shapes += [{"type": "instance", "prototype": p, "transform": _transform(rng, kind)} for p in "abab"]
    if planes:
        shapes.append(
            {
                "type": "plane",
                "point": _vector(rng),
                "normal": _vector(rng),
                "transform": _transform(rng, kind),
            }
        )
    camera = {
        "type": "perspective",
        "shutter": {"open": SHUTTER[0], "close": SHUTTER[1]},
        "transform": [{"translate": [0.5, 0.25, 3.0]}],
    }
    return Scene.model_validate({"version": 1, "camera": camera, "shapes": shapes, "prototypes": prototypes})


CASES = [
    (1, "still", False, False, False),
    (2, "stretched", False, False, True),
    (3, "stretched", False, True, True),
    (4, "moving", False, False, True),
    (5, "moving stretched", False, True, True),
    (6, "still", True, False, False),
    (7, "moving stretched", True, True, True),
    (8, "sliding", False, True, True),
]


@pytest.mark.parametrize(("seed", "kind", "deform", "instances", "planes"), CASES)
def test_hits_are_those_of_brute_force(
    probe: Any, kit: Any, seed: int, kind: str, deform: bool, instances: bool, planes: bool
) -> None:
    scene = _scene(seed, kind, deform, instances, planes)
    anchor = np.array([0.5, 0.25, 3.0])
    geometry = compile_geometry(scene, NoAssets(), FRAME, anchor, {})
    rng = np.random.default_rng(1000 + seed)
    judged = 0
    for time in (0.25, 0.3, 0.4, 0.55, 0.75):
        origins = rng.uniform(-6, 6, (RAYS, 3)).astype(np.float32).astype(np.float64)
        aims = rng.uniform(-4, 4, (RAYS, 3)) - origins
        rays = kit.rays(origins, aims / np.linalg.norm(aims, axis=1, keepdims=True), time=time)
        answers = probe.trace(geometry, rays)
        d = rays[:, 3:6].astype(np.float64)
        truth = oracle.nearest(
            scene, rays[:, :3].astype(np.float64) + anchor, d, FRAME + float(np.float32(time))
        )
        clear = (
            ~truth.doubtful
            & ((truth.second > truth.t * (1 + 1e-4)) | ~np.isfinite(truth.t))
            & ~(truth.t < 1e-3)
        )
        got = np.where(answers["kind"] == kit.NONE, np.inf, answers["t"].astype(np.float64))
        met = np.isfinite(truth.t)
        assert ((np.isfinite(got)) == met)[clear].all()
        both = clear & met
        judged += np.count_nonzero(both)
        # grazing hits amplify rounding of the direction: judge where the surface stands
        cosine = np.abs(np.einsum("ij,ij->i", d, truth.normal))
        distance = np.where(both, truth.t, 0.0)
        assert (np.abs(np.where(both, got, 0.0) - distance) * cosine <= 1e-5 * (10.0 + distance)).all()
        # the point is as near to the true surface as it says itself, but for the rounding of the scene to
        # float32
        off = np.einsum(
            "ij,ij->i",
            np.where(both[:, None], answers["p"], 0.0) - rays[:, :3] - distance[:, None] * d,
            truth.normal,
        )
        bound = np.einsum("ij,ij->i", answers["p_error"], np.abs(truth.normal))
        assert (np.abs(off) <= bound + SCENE_ROUNDING)[both].all()
        assert (np.einsum("ij,ij->i", answers["ng"], truth.normal)[both] > 0.999).all()
        ids = geometry.arrays["shapes"]["object_id"][answers["shape"][both]].astype(np.int64)
        placed = answers["instance"][both]
        by_instance = np.append(geometry.arrays["instances"]["object_id"], 0)
        of_instance = by_instance[np.where(placed == kit.NONE, -1, placed.astype(np.int64))].astype(np.int64)
        ids = np.where((placed != kit.NONE) & (of_instance > 0), of_instance, ids)
        assert (ids - 1 == truth.shape[both]).all()
        assert (answers["occluded"] == (answers["kind"] != kit.NONE)).all()
    assert judged > RAYS // 2
