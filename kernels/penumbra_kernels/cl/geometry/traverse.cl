// Walking the eight-wide tree with one ray. An instance is a leaf of the world's tree: the walk goes on in its own tree
// with the ray in its frame, and a mark on the stack says where to come back. Object-space directions are not normalised,
// so that t means the same everywhere. Metres, seconds.
#include "geometry/triangle.cl"
#include "geometry/sphere.cl"
#include "geometry/disc.cl"
#include "geometry/transform.cl"
#if PENUMBRA_DEFORMATION
#include "geometry/deforming.cl"
#endif

#define LEVEL_STACK 95u  // accel/build.py promises that no tree needs more
#if PENUMBRA_INSTANCING
#define STACK_SIZE (2u * LEVEL_STACK + 1u)
#else
#define STACK_SIZE LEVEL_STACK
#endif
#define BACK_TO_WORLD 0xffffffffu  // as a child word: the mark below an instance's entries
#define NO_CHILD 0x80000000u       // an empty leaf

// Waiting children: t in the high half, so that they compare by it (t >= 0), the child word in the low half.
typedef struct {
  ulong entries[STACK_SIZE];
  uint size;
} Stack;

static inline ulong stack_entry(const uint word, const float t) { return ((ulong)as_uint(t) << 32) | word; }

#define PLANES(node, offset) (*(const __global float8 *)((const __global float *)(node) + (offset)))

// t at which the ray enters each child's box; the mask of those that it meets no later than `end`. NaN of a plane that
// the origin lies in is always the first operand, and dropped.
static inline uint meet_boxes(const __global Node8 *node, const WideRay *w, const float end, float8 *enter) {
  const float8 zero = 0.0f, last = end;
  const float8 nx = (PLANES(node, w->near_x) - w->near_ox) * w->near_rx;
  const float8 ny = (PLANES(node, w->near_y) - w->near_oy) * w->near_ry;
  const float8 nz = (PLANES(node, w->near_z) - w->near_oz) * w->near_rz;
  const float8 fx = (PLANES(node, w->near_x ^ 8u) - w->far_ox) * w->far_rx;
  const float8 fy = (PLANES(node, w->near_y ^ 8u) - w->far_oy) * w->far_ry;
  const float8 fz = (PLANES(node, w->near_z ^ 8u) - w->far_oz) * w->far_rz;
  *enter = MAX8(nx, MAX8(ny, MAX8(nz, zero)));
  return lane_mask(*enter <= MIN8(fx, MIN8(fy, MIN8(fz, last))));
}

// Asks for the child's memory, while its siblings are still sorted: large scenes wait for that more than for anything else.
static inline void prefetch_child(const SceneData *scene, const uint word) {
  if (word & LEAF_FLAG) return;  // leaves are not worth it
  const __global char *at = (const __global char *)(scene->nodes + word);
  PREFETCH(at);
  PREFETCH(at + 64);
  PREFETCH(at + 128);
  PREFETCH(at + 192);
}

// The nearest child that is met, or NO_CHILD; the others wait on the stack, the nearer the later.
static inline uint visit_node(const SceneData *scene, const __global Node8 *node, const WideRay *w, const float end, Stack *stack) {
  float8 enter[1];
  uint mask = meet_boxes(node, w, end, enter);
  if (!mask) return NO_CHILD;
  const float *t = (const float *)enter;
  for (uint m = mask; m; m &= m - 1u) prefetch_child(scene, node->child[CTZ(m)]);
  const uint i = CTZ(mask);
  mask &= mask - 1u;
  if (!mask) return node->child[i];
  const uint j = CTZ(mask);
  mask &= mask - 1u;
  const ulong a = stack_entry(node->child[i], t[i]), b = stack_entry(node->child[j], t[j]);
  const ulong low = MIN(a, b), high = MAX(a, b);
  if (!mask) {
    stack->entries[stack->size++] = high;
    return (uint)low;
  }
  const uint bottom = stack->size;
  stack->entries[stack->size++] = high;
  stack->entries[stack->size++] = low;
  do {  // insertion, farthest first
    const uint k = CTZ(mask);
    mask &= mask - 1u;
    const ulong entry = stack_entry(node->child[k], t[k]);
    uint at = stack->size++;
    for (; at > bottom && stack->entries[at - 1u] < entry; at--) stack->entries[at] = stack->entries[at - 1u];
    stack->entries[at] = entry;
  } while (mask);
  return (uint)stack->entries[--stack->size];
}

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
