// Walking the eight-wide tree with one ray. An instance is a leaf of the world's tree: the walk goes on in its own tree
// with the ray in its frame, and a mark on the stack says where to come back. Object-space directions are not normalised,
// so that t means the same everywhere. Metres, seconds.
//
// The device's kind picks what meets nodes and triangles: eight lanes at once (nodes8.cl, triangle.cl, deforming.cl), or a thread
// a ray with compact records (compact.cl). Both give WideRay, wide_ray, visit_node, hit_packets and hit_deforming.
#include "geometry/stack.cl"
#include "geometry/sphere.cl"
#include "geometry/disc.cl"
#include "geometry/transform.cl"
#if PENUMBRA_DEFORMATION
#include "geometry/deform_time.cl"
#endif
#if PENUMBRA_COMPACT_TREE
#include "geometry/compact.cl"
#else
#include "geometry/nodes8.cl"
#include "geometry/triangle.cl"
#if PENUMBRA_DEFORMATION
#include "geometry/deforming.cl"
#endif
#endif

#if PENUMBRA_ROUND
static inline bool hit_round(const SceneData *scene, const uint word, const WideRay *w, const uint instance,
                             const bool any, Hit *best) {
  const uint index = word & LEAF_ROUND_MASK;
  const bool is_disc = (word >> LEAF_DISC_SHIFT) & 1u;
  float a = 0.0f, b = 0.0f;
  const float t = is_disc ? disc_distance(scene->discs + index, w->o, w->d, &a, &b)
                          : sphere_distance(load3(scene->spheres[index].center), scene->spheres[index].radius, w->o, w->d);
  if (!(any ? t < best->t : t <= best->t)) return false;
  if (!any) hit_offer(t, a, b, is_disc ? PRIMITIVE_DISC : PRIMITIVE_SPHERE, index, instance, best);
  return true;
}
#endif

#if PENUMBRA_INSTANCING
// The ray in an instance's frame; false where it cannot be told apart from none there.
static inline bool enter_instance(const SceneData *scene, const uint index, const Ray *ray, WideRay *w) {
  float world_from_object[3][4], object_from_world[3][4];
  instance_matrices(scene, index, ray->time, world_from_object, object_from_world);
  return wide_ray(transform_point(object_from_world, ray->o), transform_vector(object_from_world, ray->d), w);
}
#endif

// A leaf that is not an instance.
static inline bool hit_leaf(const SceneData *scene, const uint word, const WideRay *w, const float time,
                            const uint instance, const bool any, Hit *best) {
#if PENUMBRA_ROUND || PENUMBRA_DEFORMATION
  const uint type = (word >> LEAF_TYPE_SHIFT) & 3u;
#endif
#if PENUMBRA_ROUND
  if (type == LEAF_ROUND) return hit_round(scene, word, w, instance, any, best);
#endif
#if PENUMBRA_DEFORMATION
  if (type == LEAF_DEFORMING) return hit_deforming(scene, word, w, time, instance, any, best);
#endif
  return hit_packets(scene, word, w, instance, any, best);
}

// Offers everything in the world's tree to `best`; with `any`, returns true at the first hit.
static inline bool traverse(const SceneData *scene, const Ray *ray, const bool any, Hit *best) {
  WideRay w;
  if (!wide_ray(ray->o, ray->d, &w)) return false;
  Stack stack;
  stack.size = 0u;
  uint instance = NONE;
  uint word = scene->root;
  bool found = false;
  for (;;) {
    while (!(word & LEAF_FLAG)) word = visit_node(scene, scene->nodes + word, &w, best->t, &stack);
#if PENUMBRA_INSTANCING
    if (word == BACK_TO_WORLD) {
      instance = NONE;
      wide_ray(ray->o, ray->d, &w);
    } else if (((word >> LEAF_TYPE_SHIFT) & 3u) == LEAF_INSTANCE) {
      const uint index = word & LEAF_INSTANCE_MASK;
      stack.entries[stack.size++] = stack_entry(BACK_TO_WORLD, 0.0f);
      if (enter_instance(scene, index, ray, &w)) {
        instance = index;
        word = scene->instances[index].root;
        continue;
      }
    } else
#endif
    if (hit_leaf(scene, word, &w, ray->time, instance, any, best)) {
      if (any) return true;
      found = true;
    }
    do {
      if (!stack.size) return found;
      const ulong entry = stack.entries[--stack.size];
      word = as_float((uint)(entry >> 32)) <= best->t ? (uint)entry : NO_CHILD;
    } while (word == NO_CHILD);
  }
}
