// The two questions that integrators ask of the geometry: what does a ray meet first, and does it meet anything.
// Metres, seconds, world frame relative to the scene's anchor.
#include "geometry/traverse.cl"
#if PENUMBRA_ROUND
#include "geometry/plane.cl"
#endif

static inline Hit no_hit(const float tmax) {
  Hit hit;
  hit.t = tmax;
  hit.u = hit.v = 0.0f;
  hit.kind = hit.primitive = hit.instance = hit.lane = NONE;
  return hit;
}

// Closest hit in (0, tmax); false, and a hit of kind NONE, where there is none or the ray is NaN or infinite.
static inline bool intersect(const SceneData *scene, const Ray ray, Hit *hit) {
  *hit = no_hit(ray.tmax);
#if PENUMBRA_ROUND
  hit_planes(scene, &ray, false, hit);
#endif
  traverse(scene, &ray, false, hit);
  return hit->kind != NONE;
}

// Whether anything is in (0, tmax): true exactly where `intersect` is.
static inline bool occluded(const SceneData *scene, const Ray ray) {
  Hit hit = no_hit(ray.tmax);
#if PENUMBRA_ROUND
  if (hit_planes(scene, &ray, true, &hit)) return true;
#endif
  return traverse(scene, &ray, true, &hit);
}
