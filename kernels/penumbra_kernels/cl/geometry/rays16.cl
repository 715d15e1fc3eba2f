// Sixteen rays at once through a small tree, one box or primitive after the other: where all of them are near everything, no ray
// waits for its own branches. Each ray meets what traverse.cl finds for it, bit for bit. An instance is a leaf of the world's tree:
// the rays that meet it go on in its own tree, each in the frame that the instance has at its time. Metres, seconds.
#include "geometry/intersect.cl"
#include "geometry/triangle16.cl"
#if PENUMBRA_LARGE_TREES
#include "geometry/flight16.cl"
#endif
#if PENUMBRA_ROUND
#include "geometry/round16.cl"
#endif
#if PENUMBRA_INSTANCING
#include "geometry/instance16.cl"
#endif

// A leaf that is not an instance.
static inline void hit_leaf16(const SceneData *scene, const uint word, const Rays16 *r, const Mask16 on, const bool any,
                              Best16 *h) {
#if PENUMBRA_ROUND || PENUMBRA_DEFORMATION
  const uint type = (word >> LEAF_TYPE_SHIFT) & 3u;
#endif
#if PENUMBRA_ROUND
  if (type == LEAF_ROUND) {
    hit_round16(scene, word, r, on, h);
    return;
  }
#endif
#if PENUMBRA_DEFORMATION
  if (type == LEAF_DEFORMING) {
    hit_deforming16(scene, word, r, &on, any, h);
    return;
  }
#endif
  hit_packets16(scene, word, r, on, any, h);
}

#define CHILDREN 8u
#if PENUMBRA_INSTANCING
#define STACK_SIZE16 (2u * (LEVEL_STACK + CHILDREN) + 1u)
#else
#define STACK_SIZE16 (LEVEL_STACK + CHILDREN)
#endif

// Where the sixteen go next: a child word, and t at which one of them enters it; the rays that meet it.
typedef struct {
  ulong entries[STACK_SIZE16];
  uint met[STACK_SIZE16];
  uint size;
} Stack16;

// Keeps the entries from `bottom` on in order, the farthest first.
static inline void push_sorted16(Stack16 *stack, const uint bottom, const ulong entry, const uint met) {
  uint at = stack->size++;
  for (; at > bottom && stack->entries[at - 1u] < entry; at--) {
    stack->entries[at] = stack->entries[at - 1u];
    stack->met[at] = stack->met[at - 1u];
  }
  stack->entries[at] = entry;
  stack->met[at] = met;
}

static inline bool is_instance(const uint word) {
#if PENUMBRA_INSTANCING
  return ((word >> LEAF_TYPE_SHIFT) & 3u) == LEAF_INSTANCE;
#else
  return false;
#endif
}

// Leaves that a live ray meets are done at once; every other child waits on the stack, the nearer the later. All boxes come first:
// which of them are met cannot be guessed, and waiting for one after the other costs more than testing some in vain.
static inline void visit_node16(const SceneData *scene, const __global Node8 *node, const Rays16 *r, const Mask16 live, const bool any,
                                Best16 *h, Stack16 *stack) {
  const uint bottom = stack->size, on = mask16(live);
  float16 enter[CHILDREN];
  uint met[CHILDREN], children = 0u;
  for (uint i = 0u; i < CHILDREN && node->child[i] != NO_CHILD; i++) {
    met[i] = mask16(meet_box16(node, i, r->wide, h->t, enter + i)) & on;
    children |= (met[i] ? 1u : 0u) << i;
  }
  for (; children; children &= children - 1u) {
    const uint i = CTZ(children), word = node->child[i];
    if ((word & LEAF_FLAG) && !is_instance(word)) {
      Mask16 still = lanes_of_bits(met[i]) & (enter[i] <= h->t);
      if (any) still &= ~h->found;
      if (any16(still)) hit_leaf16(scene, word, r, still, any, h);
    } else push_sorted16(stack, bottom, stack_entry(word, LANE_F(enter[i], CTZ(met[i]))), met[i]);
  }
}

// The lanes of `on` only: what the others give means nothing.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void traverse16(const SceneData *scene, const Ray16 *ray, const Mask16 on, const bool any,
                                                       Best16 *h) {
  nothing_yet16(ray->tmax, h);
#if PENUMBRA_INSTANCING
  InsideRays16 inside;
#endif
#if PENUMBRA_ROUND
  hit_planes16(scene, ray, on, h);
#endif
  WideRay16 world;
  wide_ray16(&ray->o, &ray->d, &world);
  Rays16 rays = {&ray->o, &ray->d, &world, &ray->time, NONE};
  Stack16 stack;
  stack.size = 0u;
  uint word = scene->root;
  Mask16 met = on & world.is_ray;
  for (;;) {
    if (any) met &= ~h->found;
#if PENUMBRA_INSTANCING
    if (word == BACK_TO_WORLD) {
      rays.o = &ray->o;
      rays.d = &ray->d;
      rays.wide = &world;
      rays.instance = NONE;
    } else if ((word & LEAF_FLAG) && is_instance(word)) {
      const uint index = word & LEAF_INSTANCE_MASK;
      enter_instance16(scene, index, ray, &world, &h->t, &met, &inside);
      if (any16(met)) {
        // Where nothing waits in the world there is no way back.
        if (stack.size) stack.entries[stack.size++] = stack_entry(BACK_TO_WORLD, 0.0f);
        rays.o = &inside.o;
        rays.d = &inside.d;
        rays.wide = &inside.wide;
        rays.instance = index;
        word = scene->instances[index].root;
        continue;
      }
    } else
#endif
    if (any16(met)) {
      if (word & LEAF_FLAG) hit_leaf16(scene, word, &rays, met, any, h);
      else visit_node16(scene, scene->nodes + word, &rays, met, any, h, &stack);
    }
    if (!stack.size) return;
    word = (uint)stack.entries[--stack.size];
    met = lanes_of_bits(stack.met[stack.size]);
  }
}

// The first hit of each ray, of kind NONE where there is none; the lanes of `on` that have one.
static inline Mask16 intersect16(const SceneData *scene, const Ray16 *ray, const Mask16 on, Hit16 *hit) {
  Best16 best;
  traverse16(scene, ray, on, false, &best);
  hit->t = best.t;
  hit->u = best.u;
  hit->v = best.v;
  hit->kind = best.found ? best.key >> KEY_KIND_SHIFT : (uint16)(NONE);
  hit->primitive = best.key & ((1u << KEY_KIND_SHIFT) - 1u);
#if PENUMBRA_INSTANCING
  hit->instance = best.instance;
#else
  hit->instance = NONE;
#endif
  hit->lane = best.lane;
  return best.found;
}

// The lanes of `on` whose ray meets anything before its end: together, or in flight.
static inline Mask16 occluded16(const SceneData *scene, const bool together, const Ray16 *ray, const Mask16 on) {
#if PENUMBRA_LARGE_TREES
  if (!together) {
    Wing16 wing;
    wing.rays = ray;
    wing.on = on;
    fly16(scene, &wing, 1u, true);
    return wing.found;
  }
#endif
  Best16 best;
  traverse16(scene, ray, on, true, &best);
  return best.found;
}
