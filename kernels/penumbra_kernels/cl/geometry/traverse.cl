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

#if PENUMBRA_MOTION
// Whether the ray meets what the instance passes through around the ray's time. That is much less than all that it passes through
// while the shutter is open, which the tree holds, and far cheaper to ask than where it stands.
static inline bool meets_moving(const SceneData *scene, const __global Instance *instance, const float time, const WideRay *w,
                                const float end) {
  const bool outer = instance->keyframe_count > 0u;
  const uint first = outer ? instance->first_keyframe : instance->inner_first_keyframe;
  const uint count = outer ? instance->keyframe_count : instance->inner_keyframe_count;
  if (count < 2u) return true;
  const float begin = scene->keyframes[first].time;
  const float part = (time - begin) * ((float)MOTION_BOXES / (scene->keyframes[first + count - 1u].time - begin));
  const uint box = part > 0.0f ? (uint)MIN(part, (float)(MOTION_BOXES - 1u)) : 0u;
  return meets_box(scene->nodes + instance->motion_node, box, w, end);
}
#endif

#if PENUMBRA_INSTANCING
// The ray in an instance's frame; false where it misses what the instance passes through, or cannot be told apart from none there.
// end: how far the ray goes; world: the ray in the world.
static inline bool enter_instance(const SceneData *scene, const uint index, const Ray *ray, const WideRay *world,
                                  const float end, WideRay *w) {
  float world_from_object[3][4], object_from_world[3][4];
#if PENUMBRA_MOTION
  if (!meets_moving(scene, scene->instances + index, ray->time, world, end)) return false;
#endif
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
  WideRay world;
  if (!wide_ray(ray->o, ray->d, &world)) return false;
  const WideRay *w = &world;
#if PENUMBRA_INSTANCING
  WideRay inside;
#endif
  Stack stack;
  stack.size = 0u;
  uint instance = NONE;
  uint word = scene->root;
  bool found = false;
  for (;;) {
    while (!(word & LEAF_FLAG)) word = visit_node(scene, scene->nodes + word, w, best->t, &stack);
#if PENUMBRA_INSTANCING
    if (word == BACK_TO_WORLD) {
      instance = NONE;
      w = &world;
    } else if (((word >> LEAF_TYPE_SHIFT) & 3u) == LEAF_INSTANCE) {
      const uint index = word & LEAF_INSTANCE_MASK;
      if (enter_instance(scene, index, ray, &world, best->t, &inside)) {
        // Where nothing waits in the world there is no way back.
        if (stack.size) stack.entries[stack.size++] = stack_entry(BACK_TO_WORLD, 0.0f);
        w = &inside;
        instance = index;
        word = scene->instances[index].root;
        continue;
      }
    } else
#endif
    if (hit_leaf(scene, word, w, ray->time, instance, any, best)) {
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
