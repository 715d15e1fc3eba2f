"""Claims about cl/geometry/*16.cl: sixteen rays, together or in flight, meet, bit for bit, what each meets alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.together import packet_corners
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches import geometry as kit
from penumbra_kernels.hardcases.benches.geometry import BUFFERS, EFFECTS, NONE
from penumbra_kernels.layout import MATERIAL

Json = dict[str, Any]
Rays = NDArray[np.float32]

PLAIN, TEXTURED, GRAINED = range(3)
COUNT: Final = 16 * 600

ANSWER = np.dtype(
    [
        ("t", "f4"), ("u", "f4"), ("v", "f4"), ("kind", "u4"), ("primitive", "u4"), ("instance", "u4"),
        ("lane", "u4"), ("occluded", "u4"), ("p", "f4", 3), ("p_error", "f4", 3), ("ng", "f4", 3),
        ("ns", "f4", 3), ("tangent", "f4", 3), ("uv", "f4", 2), ("shape", "u4"), ("of", "u4", 3),
    ]
)  # fmt: skip

# A work-item takes sixteen rays, every second one with the corners that triangles share; answers come in threes: together, in
# flight, and alone. Lanes that are off leave 0.
TEXT = """
#include "geometry/rays16.cl"
#include "geometry/surface16.cl"

typedef struct {
  float t, u, v;
  uint kind, primitive, instance, lane, occluded;
  float p[3], p_error[3], ng[3], ns[3], tangent[3], uv[2];
  uint shape, of[3];
} Answer;

static void put3(__global float *to, const float3 v) { to[0] = v.x; to[1] = v.y; to[2] = v.z; }

static void answer(const Hit hit, const bool occluded, const bool textured, const Surface *s, __global Answer *a) {
  a->t = hit.t;
  a->kind = hit.kind;
  a->occluded = occluded ? 1u : 0u;
  if (hit.kind == NONE) return;
  a->u = hit.u;
  a->v = hit.v;
  a->primitive = hit.primitive;
  a->instance = hit.instance;
  a->lane = hit.kind == PRIMITIVE_TRIANGLE ? hit.lane : 0u;
  put3(a->p, s->p);
  put3(a->p_error, s->p_error);
  put3(a->ng, s->ng);
  put3(a->ns, s->ns);
  put3(a->tangent, s->tangent);
  a->uv[0] = textured ? s->uv.x : 0.0f;  // others ask for none
  a->uv[1] = textured ? s->uv.y : 0.0f;
  a->shape = s->shape;
  a->of[0] = s->kind;
  a->of[1] = s->primitive;
  a->of[2] = s->instance;
}

static bool is_textured(const SceneData *scene, const Surface *s) {
#if PENUMBRA_TEXTURES
  return shape_has_texture(scene, s->shape);
#else
  return false;
#endif
}

static void lane_answers(const SceneData *scene, const bool together, const Ray16 *rays, const Mask16 on,
                         __global Answer *answers) {
  Hit16 hit;
  Mask16 found;
  if (together) found = on & intersect16(scene, rays, on, &hit);
  else {
    Wing16 wing;
    wing.rays = rays;
    wing.on = on;
    fly16(scene, &wing, 1u, false);
    hit = wing.hit;
    found = on & wing.found;
  }
  const Mask16 hidden = occluded16(scene, together, rays, on);
  Surface16 surface;
  surfaces16(scene, rays, &hit, found, &surface);
  for (LANES_OF(k, on)) {
    const Surface s = lane_surface(&surface, k);
    Hit of = lane_hit(&hit, k);
    if (!LANE_I(found, k)) of.kind = NONE;
    answer(of, LANE_I(hidden, k) != 0, LANE_I(found, k) && is_textured(scene, &s), &s, answers + 3u * k);
  }
}

__kernel void probe(const __global PacketCorners *corners, const __global TreeNode *nodes,
                    const __global TreeTriangles *packets, const __global ShapeData *shapes,
                    const __global TriangleData *triangles, const __global float *positions,
                    const __global float *normals, const __global float *uvs, const __global SphereData *spheres,
                    const __global DiscData *discs, const __global PlaneData *planes,
                    const __global Instance *instances, const __global Keyframe *keyframes,
                    const __global float *times, const __global Material *materials, const uint root,
                    const uint plane_count, const __global float *rays, const __global uint *lanes,
                    __global Answer *answers) {
  SceneData scene;
  scene.nodes = nodes;
  scene.packets = packets;
  scene.corners = get_global_id(0) & 1u ? corners : 0;
  scene.shapes = shapes;
  scene.triangles = triangles;
  scene.positions = positions;
  scene.normals = normals;
  scene.uvs = uvs;
  scene.spheres = spheres;
  scene.discs = discs;
  scene.planes = planes;
  scene.instances = instances;
  scene.keyframes = keyframes;
  scene.times = times;
  scene.materials = materials;
  scene.root = root;
  scene.plane_count = plane_count;
  const uint first = (uint)get_global_id(0) * LANES;
  Mask16 on;
  Ray16 together;
  for (uint k = 0u; k < LANES; k++) {
    const __global float *r = rays + 8u * (first + k);
    const Ray ray = {load3(r), load3(r + 3), r[6], r[7]};
    set_lane_ray(&together, k, ray);
    LANE_I(on, k) = lanes[get_global_id(0)] >> k & 1u ? -1 : 0;
  }
  __global Answer *to = answers + 3u * first;
  lane_answers(&scene, true, &together, on, to);
  lane_answers(&scene, false, &together, on, to + 1);
  for (LANES_OF(k, on)) {
    const Ray ray = lane_ray(&together, k);
    Hit of;
    Surface s;
    const bool meets = intersect(&scene, ray, &of);
    if (meets) surface_to_shade(&scene, ray, of, &s);
    answer(of, occluded(&scene, ray), meets && is_textured(&scene, &s), &s, to + 3u * k + 2u);
  }
}
"""


def materials() -> NDArray[Any]:
    """By number: PLAIN, TEXTURED, GRAINED."""
    records = np.zeros(3, MATERIAL)
    records["texture0"] = records["texture1"] = NONE
    records["texture1"][TEXTURED] = 0
    records["alpha_x"][GRAINED] = 0.5
    return records


class Lanes:
    """The program with a set of effects."""

    def __init__(self, device: Device, kind: dict[str, int], **effects: int) -> None:
        flags = {f"PENUMBRA_{name}": effects.get(name, 1) for name in EFFECTS} | {
            "PENUMBRA_GLOSS": 1,
            "PENUMBRA_LARGE_TREES": 1,
        }
        cpu = {"PENUMBRA_DEVICE_GPU": 0, "PENUMBRA_COMPACT_TREE": 0}
        self.device = device
        self.kernel = device.build("probe.cl", {**flags, **device.flags, **cpu, **kind}, TEXT).probe

    def both(self, geometry: Any, rays: Rays, seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """(lanes, scalars) of the rays that are on, once those together and those in flight agree; the others are NaN."""
        rng = np.random.default_rng(seed)
        groups = len(rays) // 16
        on = rng.random((groups, 16)) < rng.choice([0.1, 0.5, 0.9, 1.0], groups)[:, None]
        bits = (on << np.arange(16)).sum(axis=1).astype(np.uint32)
        given = np.where(on.reshape(-1, 1), rays, np.float32(np.nan))
        device = self.device
        arrays = dict(geometry.arrays)
        arrays["shapes"] = arrays["shapes"].copy()
        arrays["shapes"]["material"] = np.arange(len(arrays["shapes"])) % 3
        arrays["corners"] = packet_corners(arrays["packets"])
        buffers = [device.upload(arrays[name]) for name in ("corners", *BUFFERS)]
        buffers += [device.upload(a) for a in (geometry.keyframes, arrays["times"], materials())]
        answers = np.zeros((len(rays), 3), ANSWER)
        out = device.upload(answers)
        scalars = (np.uint32(geometry.root), np.uint32(geometry.plane_count))
        device.launch(
            self.kernel, [*buffers, *scalars, device.upload(given), device.upload(bits), out], groups, 1
        )
        device.download(out, answers)
        assert not any(np.any(answers[name][~on.ravel()]) for name in ANSWER.names or ())
        kept = answers[on.ravel()]
        agree(kept[:, 0], kept[:, 1])
        return kept[:, 1], kept[:, 2]


def agree(lanes: NDArray[Any], scalars: NDArray[Any]) -> None:
    """The same bits, where NaN has any."""
    for name in ANSWER.names or ():
        a, b = lanes[name], scalars[name]
        if a.dtype == np.float32:
            a, b = (np.where(np.isnan(x), np.uint32(0x7FC00000), x.view(np.uint32)) for x in (a, b))
        np.testing.assert_array_equal(a, b, err_msg=name)


def mixed_rays(seed: int, corners: NDArray[np.float64] | None = None) -> Rays:
    """Rays of all sorts, in groups that are alike and in such that are not: through the cube [-1, 1]^3, along axes, of other
    lengths, ends and times; through corners and the middle of edges where those are given (n, 3, 3)."""
    rng = np.random.default_rng(seed)
    origins = 3 * kit.directions(rng, COUNT) * rng.choice([0.1, 1, 1, 100], (COUNT, 1))
    targets = rng.uniform(-1, 1, (COUNT, 3))
    if corners is not None:
        picked = corners[rng.integers(0, len(corners), COUNT // 2)]
        weights = np.array([[1, 0, 0], [0, 0.5, 0.5], [0.25, 0.75, 0]])[rng.integers(0, 3, COUNT // 2)]
        targets[: COUNT // 2] = np.einsum("ni,nij->nj", weights, picked)
    alike = rng.random(COUNT // 16) < 0.5
    spread = np.where(np.repeat(alike, 16)[:, None], 1e-3, 1.0)
    origins = np.repeat(origins[::16], 16, axis=0) * (spread < 1) + origins * (spread == 1)
    targets = np.repeat(targets[::16], 16, axis=0) * (spread < 1) + targets * spread
    directions = (targets - origins) * 10.0 ** rng.choice([-3, 0, 0, 0, 4], (COUNT, 1))
    some = rng.random(COUNT) < 0.1
    directions[some] *= np.eye(3)[rng.integers(0, 3, some.sum())]
    rays = kit.rays(origins, directions, time=rng.choice([-0.5, 0, 0.25, 0.5, 1, 1.5], COUNT))
    blurred = rng.random(COUNT) < 0.7
    rays[blurred, 7] = rng.random(blurred.sum())
    ended = rng.random(COUNT) < 0.2
    rays[ended, 6] = rng.uniform(0, 2, ended.sum())
    return rays


def broken_rays(seed: int) -> Rays:
    """Rays of which some are none: zero or infinite directions, NaN anywhere, ends that are none."""
    rays = mixed_rays(seed)
    rng = np.random.default_rng(seed + 1)
    rays[rng.random(COUNT) < 0.1, 3:6] = 0.0
    for value in (np.nan, np.inf, -np.inf, 1e-42, 3e38):
        where = rng.random((COUNT, 8)) < 0.03
        where[:, 7] &= np.isfinite(value)
        rays[where] = value
    return rays


def corners_of(mesh: Json) -> NDArray[np.float64]:
    corners: NDArray[np.float64] = np.asarray(mesh["positions"], np.float64)[np.asarray(mesh["indices"])]
    return corners


def soup(seed: int, n: int, size: float, copies: int = 1, **more: Any) -> Json:
    """Triangles, each `copies` times over; those in a plane parallel to two axes and needles among them."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(-1, 1, (n, 1, 3)) + size * rng.normal(size=(n, 3, 3))
    v[: n // 8, :, 1] = v[: n // 8, :1, 1]
    v[n // 8 : n // 6, 2] = v[n // 8 : n // 6, 1] + 1e-6
    v = np.repeat(v, copies, axis=0)
    return {
        "type": "mesh",
        "positions": v.reshape(-1, 3).tolist(),
        "indices": np.arange(v.size // 3).reshape(-1, 3).tolist(),
        **more,
    }


def grid(n: int, **more: Any) -> Json:
    """A wavy sheet of n^2 quads whose triangles share corners, with normals and uv of its own."""
    x, z = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    p = np.stack([x, 0.3 * np.sin(3 * x + z), z], axis=-1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + n + 1, a + 1], 1), np.stack([a + 1, a + n + 1, a + n + 2], 1)])
    return {
        "type": "mesh",
        "positions": p.tolist(),
        "indices": faces.tolist(),
        "uvs": (0.5 + 0.5 * p[:, ::2]).tolist(),
        "smooth": True,
        **more,
    }


def keyframes(*transforms: list[Json]) -> Json:
    times = np.linspace(0, 1, len(transforms)).tolist()
    return {"keyframes": [{"time": t, "transform": m} for t, m in zip(times, transforms, strict=True)]}


def turned(angle: float, *more: Json) -> list[Json]:
    return [{"rotate": {"axis": [1, 2, 0.5], "angle": angle}}, *more]


def moved(x: float, y: float, z: float) -> Json:
    return {"translate": [x, y, z]}


MIRROR = {"scale": [-1, 1.3, 0.8]}
SLIDE = keyframes([MIRROR, moved(-0.5, 0, 0)], [MIRROR, moved(0.5, 0.4, 0)])
ZIGZAG = keyframes([moved(0, -0.5, 0)], [moved(0.3, 0.5, 0)], [moved(0, -0.2, 0.4)], [moved(0, 0, 0)])
TURN = keyframes(turned(0), turned(60, {"scale": [1, 0.5, 1.5]}), turned(170, moved(0.2, 0, 0)))


def triangles() -> list[Json]:
    quad = {"type": "quad", "origin": [-0.5, -0.9, -0.5], "u": [1, 0, 0.2], "v": [0, 0.1, 1]}
    return [
        soup(1, 40, 0.4),
        soup(2, 10, 0.5, copies=3),
        grid(6),
        quad,
        {**quad, "transform": MIRROR},
        soup(3, 10, 1e-3),
    ]


def rounds() -> list[Json]:
    rng = np.random.default_rng(4)
    balls = [{"type": "sphere", "center": rng.uniform(-1, 1, 3).tolist(), "radius": 0.2} for _ in range(12)]
    plates = [
        {"type": "disc", "center": c, "normal": n, "radius": 0.4}
        for c, n in zip(rng.uniform(-1, 1, (9, 3)).tolist(), kit.directions(rng, 9).tolist(), strict=True)
    ]
    stretched = [
        {**plates[0], "transform": turned(30, MIRROR)},
        {**balls[0], "transform": turned(30, {"scale": [-1, 1, 1]})},
    ]
    planes = [{"type": "plane", "point": [0, -0.9, 0]}] * 2 + [{"type": "plane", "normal": [1, 0.2, 0.1]}]
    return [*balls, *balls[:3], *plates, plates[2], *stretched, *planes, soup(5, 5, 0.3)]


def moving() -> list[Json]:
    ball = {"type": "sphere", "radius": 0.4}
    return [
        {**ball, "transform": SLIDE},
        {**ball, "transform": ZIGZAG},
        {**ball, "transform": TURN},
        {**grid(3), "transform": TURN},
        {**soup(6, 12, 0.4), "transform": SLIDE},
        {"type": "disc", "radius": 0.5, "transform": ZIGZAG},
        {"type": "plane", "point": [0, -0.8, 0], "transform": TURN},
        {"type": "plane", "point": [0, 0, -1.5], "normal": [0, 0, 1]},
        soup(7, 5, 0.3),
    ]


PROTOTYPES: Final = {
    "still": [grid(3), {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.3}],
    "inner": [{"type": "sphere", "radius": 0.3, "transform": TURN}, {**soup(8, 6, 0.4), "transform": SLIDE}],
    "ball": [{"type": "sphere", "radius": 0.3}],
}


def instances() -> list[Json]:
    def of(prototype: str, transform: Any = ()) -> Json:
        return {"type": "instance", "prototype": prototype, "transform": transform}

    twice = [of("still", turned(40, MIRROR))] * 3
    still = [
        *twice,
        of("still", [{"scale": [0.5, 0.5, 0.5]}, moved(0.4, 0, 0)]),
        of("ball", [moved(-0.5, 0.5, 0)]),
    ]
    return [
        *still,
        of("inner"),
        of("inner", TURN),
        of("still", SLIDE),
        of("ball", ZIGZAG),
        of("inner", ZIGZAG),
        soup(9, 5, 0.3),
    ]


def deforming() -> list[Json]:
    flag, heap = grid(4), soup(10, 20, 0.4)

    def waved(mesh: Json, steps: int, **more: Any) -> Json:
        p = np.asarray(mesh["positions"])
        forms = [p + 0.3 * k * np.sin(4 * p[:, ::-1] + k) for k in range(steps)]
        times = np.linspace(0, 1, steps).tolist()
        frames = [{"time": t, "positions": f.tolist()} for t, f in zip(times, forms, strict=True)]
        return {**mesh, "deformation": frames, **more}

    return [
        waved(flag, 3),
        waved(heap, 2),
        waved(flag, 2, transform=TURN),
        waved(heap, 3, transform=SLIDE),
        *moving()[:2],
    ]


SCENES: Final[dict[str, Callable[[], list[Json]]]] = {
    "triangles": triangles,
    "rounds": rounds,
    "moving": moving,
    "instances": instances,
    "deforming": deforming,
}
KINDS: Final[dict[str, dict[str, int]]] = {
    "native": {},
    "portable": {"PENUMBRA_BUILTINS": 0, "PENUMBRA_X86": 0},
}


def compiled(shapes: list[Json], prototypes: dict[str, list[Json]] = PROTOTYPES) -> Any:
    camera = {"type": "perspective", "shutter": {"open": 0, "close": 1}}
    used = {shape.get("prototype") for shape in shapes}
    return kit.compiled(shapes, camera=camera, prototypes={k: v for k, v in prototypes.items() if k in used})


@pytest.fixture(scope="module", params=KINDS)
def all_lanes(request: pytest.FixtureRequest, device: Device) -> Lanes:
    """The program with every effect."""
    return Lanes(device, KINDS[request.param])


@pytest.mark.parametrize("name", SCENES)
def test_sixteen_rays_meet_what_each_meets_alone(name: str, all_lanes: Lanes) -> None:
    shapes = SCENES[name]()
    corners = [corners_of(s) for s in shapes if s["type"] == "mesh"]
    lanes, scalars = all_lanes.both(compiled(shapes), mixed_rays(20, np.concatenate(corners)), 21)
    agree(lanes, scalars)
    hits = scalars[scalars["kind"] != NONE]
    assert 0.3 < len(hits) / len(scalars) < 0.98
    for i in range(3):
        assert np.mean(hits["shape"] % 3 == i) > 0.02  # of each material


@pytest.mark.parametrize("name", SCENES)
def test_what_is_no_ray_meets_nothing_in_lanes_too(name: str, all_lanes: Lanes) -> None:
    lanes, scalars = all_lanes.both(compiled(SCENES[name]()), broken_rays(30), 31)
    agree(lanes, scalars)
    assert 0.1 < np.mean(scalars["kind"] != NONE) < 0.8


def test_ties_go_to_the_first_in_lanes_too(all_lanes: Lanes) -> None:
    """Copies of triangles, of spheres, discs and planes, of instances, all at equal t."""
    geometry = compiled([soup(40, 6, 0.6, copies=4), *rounds(), *instances()])
    lanes, scalars = all_lanes.both(geometry, mixed_rays(41), 42)
    agree(lanes, scalars)
    three = sorted(set(scalars["instance"][(scalars["instance"] != NONE)]))
    assert not {1, 2} & set(three)  # the second and third of three equal ones never show
    assert {0, 3} <= set(three)


def test_a_scene_of_one_thing(all_lanes: Lanes) -> None:
    """The tree's root is a leaf: a triangle, a sphere, an instance; or there is nothing."""
    rays = mixed_rays(50)
    for shapes in (
        [],
        [soup(51, 1, 1.0)],
        [moving()[0]],
        [{"type": "sphere", "radius": 0.5}],
        [instances()[0]],
    ):
        lanes, scalars = all_lanes.both(compiled(shapes), rays, 52)
        agree(lanes, scalars)
        assert np.any(scalars["kind"] != NONE) == bool(shapes)


def test_trees_with_far_more_nodes_than_rays_visit(all_lanes: Lanes) -> None:
    """Triangles in the world, and instances of large meshes that stand in each other."""
    prototypes = {"heap": [soup(70, 3000, 0.05), {"type": "sphere", "radius": 0.1}], "sheet": [grid(40)]}
    placed = [(name, turned(50, moved(x, 0, x))) for name in prototypes for x in (0.0, 0.4)]
    shapes: list[Json] = [soup(71, 2000, 0.1)]
    shapes += [{"type": "instance", "prototype": name, "transform": at} for name, at in placed]
    geometry = compiled(shapes, prototypes)
    assert len(geometry.arrays["nodes"]) > 150
    lanes, scalars = all_lanes.both(geometry, mixed_rays(72, corners_of(shapes[0])), 73)
    agree(lanes, scalars)
    assert 0.3 < np.mean(scalars["kind"] != NONE) < 0.98
    assert 0.1 < np.mean(scalars["instance"][scalars["kind"] != NONE] != NONE) < 0.9


SPECIALISED: Final[dict[str, dict[str, int]]] = {
    "triangles": {"ROUND": 0, "INSTANCING": 0, "MOTION": 0, "DEFORMATION": 0, "TEXTURES": 0},
    "rounds": {"INSTANCING": 0, "MOTION": 0, "DEFORMATION": 0},
    "moving": {"DEFORMATION": 0},
}


@pytest.mark.parametrize("name", SPECIALISED)
def test_programs_without_what_a_scene_has_not(name: str, device: Device) -> None:
    few = Lanes(device, {}, **SPECIALISED[name])
    lanes, scalars = few.both(compiled(SCENES[name]()), mixed_rays(60), 61)
    agree(lanes, scalars)
    assert np.mean(scalars["kind"] != NONE) > 0.1
