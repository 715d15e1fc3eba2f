"""What surface_at says of a hit: uv, normals, tangents, and rays from surface to surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

RAYS = 5_000
POINT = 2e-5
"""Metres: points of triangles are pulled inside by their rounding, some 60 ulp of coordinates up to 5 m."""

TRANSFORMS = {
    "still": [],
    "turned": [{"rotate": {"axis": [1, 2, 3], "angle": 70}}, {"translate": [1, 2, 3]}],
    "mirrored": [{"scale": [-1, 1, 1]}, {"rotate": {"axis": [1, 2, 3], "angle": 70}}],
    "stretched": [{"scale": [2, 0.5, 1]}, {"rotate": {"axis": [1, 2, 3], "angle": 70}}, {"scale": [1, 3, 1]}],
}


def _hits(probe: Any, kit: Any, geometry: Any, center: Any, reach: float, kind: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(1)
    origins = np.asarray(center) + kit.directions(rng, RAYS) * 3 * reach
    rays = kit.rays(origins, np.asarray(center) + rng.uniform(-1, 1, (RAYS, 3)) * 0.4 * reach - origins)
    answers = probe.trace(geometry, rays)
    met = answers["kind"] == kind
    assert np.count_nonzero(met) > RAYS // 20
    return answers[met], rays[met]


def _matrix(steps: Any) -> Any:
    from penumbra_kernels.compile.transforms import matrix_of
    from penumbra_scene.shapes import Sphere

    return matrix_of(Sphere.model_validate({"type": "sphere", "transform": steps}).transform)


def _model(steps: Any, placed: str, shape: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """The shape under the steps: directly, or as an instance of a prototype."""
    if placed == "directly":
        return [{**shape, "transform": steps}], {}
    return [{"type": "instance", "prototype": "p", "transform": steps}], {"prototypes": {"p": [shape]}}


@pytest.mark.parametrize("placed", ["directly", "instance"])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_quads_uv_are_its_own_coordinates(probe: Any, kit: Any, name: str, placed: str) -> None:
    o, u, v = np.array([-1, -0.5, 0.2]), np.array([1.5, 0.2, 0.1]), np.array([0.3, 1.2, -0.4])
    shapes, extra = _model(
        TRANSFORMS[name], placed, {"type": "quad", "origin": o.tolist(), "u": u.tolist(), "v": v.tolist()}
    )
    m = _matrix(TRANSFORMS[name])
    a, _ = _hits(
        probe, kit, kit.compiled(shapes, **extra), m[:3, :3] @ (o + (u + v) / 2) + m[:3, 3], 2, kit.TRIANGLE
    )
    own = o + a["uv"][:, :1] * u + a["uv"][:, 1:] * v
    assert np.abs(own @ m[:3, :3].T + m[:3, 3] - a["p"]).max() < POINT
    normal = kit.unit(np.linalg.inv(m[:3, :3]).T @ np.cross(u, v))
    assert np.abs(a["ng"] - normal).max() < 1e-5
    assert np.abs(a["ns"] - normal).max() < 1e-5
    assert np.abs(a["tangent"] - kit.unit(m[:3, :3] @ u)).max() < 1e-5


@pytest.mark.parametrize("placed", ["directly", "instance"])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_spheres_uv_are_longitude_and_latitude(probe: Any, kit: Any, name: str, placed: str) -> None:
    center, radius = np.array([0.5, 0.2, -0.3]), 0.8
    shapes, extra = _model(
        TRANSFORMS[name], placed, {"type": "sphere", "center": center.tolist(), "radius": radius}
    )
    m = _matrix(TRANSFORMS[name])
    a, _ = _hits(probe, kit, kit.compiled(shapes, **extra), m[:3, :3] @ center + m[:3, 3], 2, kit.SPHERE)
    longitude, latitude = 2 * np.pi * a["uv"][:, 0].astype(float), np.pi * (a["uv"][:, 1].astype(float) - 0.5)
    own = np.stack(
        [np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], 1
    )
    assert np.abs((center + radius * own) @ m[:3, :3].T + m[:3, 3] - a["p"]).max() < 2e-5
    normal = kit.unit(own @ np.linalg.inv(m[:3, :3]))
    assert np.abs(a["ng"] - normal).max() < 2e-5
    along = np.stack([np.cos(longitude), 0 * longitude, -np.sin(longitude)], 1) @ m[:3, :3].T
    away = np.cos(latitude) > 0.05
    assert (np.abs(a["tangent"] - kit.unit(along))[away]).max() < 1e-4


@pytest.mark.parametrize("placed", ["directly", "instance"])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_discs_uv_span_its_square(probe: Any, kit: Any, name: str, placed: str) -> None:
    """Facing +Z: u along X, v along Y, (0.5, 0.5) at the center."""
    shapes, extra = _model(
        TRANSFORMS[name], placed, {"type": "disc", "center": [0.1, 0.2, 0.3], "radius": 0.7}
    )
    m = _matrix(TRANSFORMS[name])
    a, _ = _hits(
        probe, kit, kit.compiled(shapes, **extra), m[:3, :3] @ [0.1, 0.2, 0.3] + m[:3, 3], 1.5, kit.DISC
    )
    flat = (a["uv"].astype(float) * 2 - 1) * 0.7
    own = np.array([0.1, 0.2, 0.3]) + np.concatenate([flat, 0 * flat[:, :1]], 1)
    assert np.abs(own @ m[:3, :3].T + m[:3, 3] - a["p"]).max() < POINT
    assert np.abs(a["ng"] - kit.unit(np.linalg.inv(m[:3, :3]).T @ [0, 0, 1])).max() < 1e-5
    assert (np.linalg.norm(flat, axis=1) <= 0.7 * 1.00001).all()


@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_planes_uv_are_metres_in_its_own_frame(probe: Any, kit: Any, name: str) -> None:
    """Facing +Y: u along X, v along -Z, from its point."""
    point = np.array([0.5, -0.2, 0.3])
    m = _matrix(TRANSFORMS[name])
    plane = {"type": "plane", "point": point.tolist(), "transform": TRANSFORMS[name]}
    a, _ = _hits(probe, kit, kit.compiled([plane]), m[:3, :3] @ point + m[:3, 3], 2, kit.PLANE)
    near = np.linalg.norm(a["p"], axis=1) < 20
    uv = a["uv"].astype(float)[near]
    own = point + np.stack([uv[:, 0], 0 * uv[:, 0], -uv[:, 1]], 1)
    assert np.abs(own @ m[:3, :3].T + m[:3, 3] - a["p"][near]).max() < 1e-4
    assert np.abs(a["ng"] - kit.unit(np.linalg.inv(m[:3, :3]).T @ [0, 1, 0])).max() < 1e-5


@pytest.mark.parametrize("placed", ["directly", "instance"])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_vertex_normals_and_uvs_are_interpolated(probe: Any, kit: Any, name: str, placed: str) -> None:
    corners = np.array([[-1, -1, 0], [1, -1, 0.2], [0, 1, -0.3]])
    normals = kit.unit(np.array([[0.3, 0, 1], [-0.3, 0.1, 1], [0, -0.4, 1]]))
    uvs = np.array([[0.1, 0.2], [0.9, 0.3], [0.4, 2.0]])
    mesh = {
        "type": "mesh",
        "positions": corners.tolist(),
        "indices": [[0, 1, 2]],
        "normals": normals.tolist(),
        "uvs": uvs.tolist(),
    }
    shapes, extra = _model(TRANSFORMS[name], placed, mesh)
    m = _matrix(TRANSFORMS[name])
    a, _ = _hits(probe, kit, kit.compiled(shapes, **extra), m[:3, 3] - m[:3, 1] * 0.2, 2, kit.TRIANGLE)
    b = np.stack([1 - a["u"] - a["v"], a["u"], a["v"]], 1).astype(float)
    assert np.abs(b @ uvs - a["uv"]).max() < 1e-5
    inverse = np.linalg.inv(m[:3, :3])
    assert np.abs(a["ns"] - kit.unit(b @ kit.unit(normals @ inverse))).max() < (
        1e-5 if placed == "directly" else 1
    )
    assert (np.einsum("ij,ij->i", a["ns"], a["ng"]) > 0).all()
    assert np.abs(np.einsum("ij,ij->i", a["ns"], a["tangent"])).max() < 1e-5
    outside = kit.unit(inverse.T @ np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    assert np.abs(a["ng"] - outside).max() < 1e-5


def test_smooth_normals_of_a_sphere_mesh_are_the_spheres(probe: Any, kit: Any) -> None:
    theta, phi = np.linspace(0, np.pi, 41)[1:-1], np.linspace(0, 2 * np.pi, 80, endpoint=False)
    points = [[np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)] for t in theta for p in phi]
    faces = []
    for i in range(38):
        for j in range(80):
            a, b, c, d = (i * 80 + j, i * 80 + (j + 1) % 80, (i + 1) * 80 + (j + 1) % 80, (i + 1) * 80 + j)
            faces += [[a, b, c], [a, c, d]]
    mesh = {"type": "mesh", "positions": points, "indices": faces, "smooth": True}
    a, _ = _hits(probe, kit, kit.compiled([mesh]), (0, 0, 0), 1, kit.TRIANGLE)
    middle = np.abs(a["p"][:, 1]) < 0.9
    assert np.abs(a["ns"] - kit.unit(a["p"]))[middle].max() < 2e-3
    assert np.abs(a["ng"] - kit.unit(a["p"]))[middle].max() > 1e-2


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_a_shadow_ray_reaches_a_light_and_stops_short_of_it(device: Any, kit: Any, scale: float) -> None:
    """From floor to wall (they share an edge) and from floor to lid nothing stands in the way of any ray."""
    import pyopencl as cl
    from penumbra_kernels.accel.compact import tree_arrays
    from penumbra_kernels.program import assemble

    text = """
#include "geometry/intersect.cl"
#include "geometry/surface.cl"
__kernel void shadow(const __global TreeNode *nodes, const __global TreeTriangles *packets,
                     const __global ShapeData *shapes,
                     const __global TriangleData *triangles, const __global float *positions, const uint root,
                     const __global float *rays, const __global float *targets, __global uint *blocked) {
  SceneData scene;
  scene.nodes = nodes; scene.packets = packets; scene.shapes = shapes; scene.triangles = triangles;
  scene.positions = positions; scene.root = root; scene.plane_count = 0;
  const uint i = get_global_id(0);
  Ray a, b;
  a.o = load3(rays + 6 * i); a.d = load3(rays + 6 * i + 3); a.tmax = INF_F; a.time = 0.0f;
  b = a;
  b.d = load3(targets + 3 * i);
  Hit here, there;
  Surface from, to;
  if (!intersect(&scene, a, &here) || !intersect(&scene, b, &there)) { blocked[i] = 2u; return; }
  surface_at(&scene, a, here, &from);
  surface_at(&scene, b, there, &to);
  blocked[i] = occluded(&scene, spawn_ray_to(&from, to.p, to.p_error, to.ng, 0.0f)) ? 1u : 0u;
}
"""
    flags = {f"PENUMBRA_{name}": 0 for name in ("ROUND", "INSTANCING", "MOTION", "DEFORMATION", "TEXTURES")}
    program = cl.Program(device.context, assemble("shadow.cl", {**flags, **device.flags}, text)).build(
        list(device.options)
    )
    kernel = cl.Kernel(program, "shadow")
    s = scale
    floor = {"type": "quad", "origin": [-s, -s, 0], "u": [2 * s, 0, 0], "v": [0, 2 * s, 0]}
    wall = {"type": "quad", "origin": [-s, s, 0], "u": [2 * s, 0, 0], "v": [0, 0, 2 * s]}  # shares an edge
    lid = {"type": "quad", "origin": [-s, -s, 2 * s], "u": [2 * s, 0, 0], "v": [0, 2 * s, 0]}
    rng = np.random.default_rng(5)
    n = 20_000
    eye = np.broadcast_to(np.array([0, 0, 0.5 * s]), (n, 3))
    floor_points = np.concatenate([rng.uniform(-0.99, 0.99, (n, 2)), np.zeros((n, 1))], 1) * s
    height = np.exp(rng.uniform(np.log(1e-3), 0, n))
    wall_points = np.stack([rng.uniform(-0.99, 0.99, n), np.ones(n), height], 1) * s
    lid_points = np.concatenate([rng.uniform(-0.99, 0.99, (n, 2)), np.full((n, 1), 2.0)], 1) * s
    for other, points in ((wall, wall_points), (lid, lid_points)):
        geometry = kit.compiled([floor, other])
        rays = np.concatenate([eye, floor_points - eye], 1).astype(np.float32)
        targets = (points - eye).astype(np.float32)
        names = ("nodes", "packets", "shapes", "triangles", "positions")
        arrays = tree_arrays(geometry.arrays, device.flags)
        buffers = [device.upload(arrays[name]) for name in names]
        uploaded, out = (device.upload(rays), device.upload(targets)), device.allocate(4 * n)
        device.launch(kernel, [*buffers, np.uint32(geometry.root), *uploaded, out], n, 1)
        blocked = np.zeros(n, np.uint32)
        device.download(out, blocked)
        assert (blocked == 0).all()
