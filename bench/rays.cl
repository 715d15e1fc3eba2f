// Rays of an array through the tracer's geometry, as trace.cl calls it: what bench/rays.py times.
#include "base/types.h"
#include "geometry/intersect.cl"

#define RAYS_PER_ITEM 64u

static inline SceneData scene_of(const __global Node8 *nodes, const __global Packet8 *packets, const uint root) {
  SceneData scene;
  scene.nodes = nodes;
  scene.packets = packets;
  scene.root = root;
  scene.plane_count = 0u;
  return scene;
}

static inline Ray ray_at(const __global float *rays, const uint i) {
  const __global float *p = rays + 8ul * i;
  Ray ray;
  ray.o = load3(p);
  ray.d = load3(p + 3);
  ray.tmax = p[6];
  ray.time = 0.0f;
  return ray;
}

__kernel void closest(const __global Node8 *nodes, const __global Packet8 *packets, const uint root,
                      const __global float *rays, const uint count, __global float2 *out) {
  const SceneData scene = scene_of(nodes, packets, root);
  const uint first = (uint)get_global_id(0) * RAYS_PER_ITEM, end = MIN(first + RAYS_PER_ITEM, count);
  for (uint i = first; i < end; i++) {
    Hit hit;
    intersect(&scene, ray_at(rays, i), &hit);
    out[i] = (float2)(hit.t, as_float(hit.primitive));
  }
}

__kernel void any_hit(const __global Node8 *nodes, const __global Packet8 *packets, const uint root,
                      const __global float *rays, const uint count, __global uint *out) {
  const SceneData scene = scene_of(nodes, packets, root);
  const uint first = (uint)get_global_id(0) * RAYS_PER_ITEM, end = MIN(first + RAYS_PER_ITEM, count);
  for (uint i = first; i < end; i++) out[i] = occluded(&scene, ray_at(rays, i)) ? 1u : 0u;
}
