// Traces rays and writes what intersect, surface_at, occluded and spawn_ray say of it.
#include "geometry/intersect.cl"
#include "geometry/surface.cl"

// One ray a work-item on GPUs; on CPUs many, since PoCL spends some 3 ns on each item.
#if PENUMBRA_DEVICE_GPU
#define RAYS_PER_ITEM 1u
#else
#define RAYS_PER_ITEM 64u
#endif

typedef struct {
  float t, u, v;
  uint kind, primitive, instance, shape, occluded;
  float p[3], p_error[3], ng[3], ns[3], tangent[3], uv[2], origin[3];
} Answer;

static inline void store3(__global float *to, const float3 v) {
  to[0] = v.x;
  to[1] = v.y;
  to[2] = v.z;
}

static inline void answer_surface(const SceneData *scene, const Ray ray, const Hit hit, const float side, __global Answer *a) {
  Surface s;
  surface_at(scene, ray, hit, &s);
  store3(a->p, s.p);
  store3(a->p_error, s.p_error);
  store3(a->ng, s.ng);
  store3(a->ns, s.ns);
  store3(a->tangent, s.tangent);
  a->uv[0] = s.uv.x;
  a->uv[1] = s.uv.y;
  a->shape = s.shape;
  store3(a->origin, spawn_ray(&s, s.ng * side, ray.time).o);
}

static inline void answer_nothing(__global Answer *a) {
  const float3 zero = (float3)(0.0f);
  store3(a->p, zero);
  store3(a->p_error, zero);
  store3(a->ng, zero);
  store3(a->ns, zero);
  store3(a->tangent, zero);
  a->uv[0] = a->uv[1] = 0.0f;
  store3(a->origin, zero);
}

// Rays: origin, direction, tmax, time. `side`: which side of ng the spawned origin is on.
__kernel void probe(const __global TreeNode *nodes, const __global TreeTriangles *packets, const __global ShapeData *shapes,
                    const __global TriangleData *triangles, const __global float *positions,
                    const __global float *normals, const __global float *uvs, const __global SphereData *spheres,
                    const __global DiscData *discs, const __global PlaneData *planes,
                    const __global Instance *instances, const __global Keyframe *keyframes,
                    const __global float *times, const uint root, const uint plane_count, const float side,
                    const __global float *rays, const uint count, __global Answer *answers) {
  SceneData scene;
  scene.nodes = nodes;
  scene.packets = packets;
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
  scene.root = root;
  scene.plane_count = plane_count;
  const uint first = (uint)get_global_id(0) * RAYS_PER_ITEM, end = MIN(first + RAYS_PER_ITEM, count);
  for (uint i = first; i < end; i++) {
    const __global float *r = rays + 8u * i;
    Ray ray;
    ray.o = load3(r);
    ray.d = load3(r + 3);
    ray.tmax = r[6];
    ray.time = r[7];
    Hit hit;
    const bool found = intersect(&scene, ray, &hit);
    answers[i].t = hit.t;
    answers[i].u = hit.u;
    answers[i].v = hit.v;
    answers[i].kind = hit.kind;
    answers[i].primitive = hit.primitive;
    answers[i].instance = hit.instance;
    answers[i].shape = NONE;
    answers[i].occluded = occluded(&scene, ray) ? 1u : 0u;
    if (found) {
      answer_surface(&scene, ray, hit, side, answers + i);
    } else {
      answer_nothing(answers + i);
    }
  }
}
