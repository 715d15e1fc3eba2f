// Eight boxes of a node against one ray, all at once. Metres in the tree's frame.
#include "geometry/wide.cl"
#include "geometry/stack.cl"

#define PLANES(node, offset) (*(const __global float8 *)((const __global float *)(node) + (offset)))

// t at which the ray enters each child's box; those that it meets no later than `end`. NaN of a plane that the origin lies
// in is always the first operand, and dropped.
static inline int8 meet_boxes(const __global Node8 *node, const WideRay *w, const float end, float8 *enter) {
  const float8 zero = 0.0f, last = end;
  const float8 nx = (PLANES(node, w->near_x) - w->near_ox) * w->near_rx;
  const float8 ny = (PLANES(node, w->near_y) - w->near_oy) * w->near_ry;
  const float8 nz = (PLANES(node, w->near_z) - w->near_oz) * w->near_rz;
  const float8 fx = (PLANES(node, w->near_x ^ 8u) - w->far_ox) * w->far_rx;
  const float8 fy = (PLANES(node, w->near_y ^ 8u) - w->far_oy) * w->far_ry;
  const float8 fz = (PLANES(node, w->near_z ^ 8u) - w->far_oz) * w->far_rz;
  *enter = MAX8(nx, MAX8(ny, MAX8(nz, zero)));
  return *enter <= MIN8(fx, MIN8(fy, MIN8(fz, last)));
}

// The same for one child: whether the ray meets its box no later than `end`.
static inline bool meets_box(const __global Node8 *node, const uint lane, const WideRay *w, const float end) {
  const __global float *p = (const __global float *)node + lane;
  const float nx = (p[w->near_x] - w->near_ox.s0) * w->near_rx.s0;
  const float ny = (p[w->near_y] - w->near_oy.s0) * w->near_ry.s0;
  const float nz = (p[w->near_z] - w->near_oz.s0) * w->near_rz.s0;
  const float fx = (p[w->near_x ^ 8u] - w->far_ox.s0) * w->far_rx.s0;
  const float fy = (p[w->near_y ^ 8u] - w->far_oy.s0) * w->far_ry.s0;
  const float fz = (p[w->near_z ^ 8u] - w->far_oz.s0) * w->far_rz.s0;
  const float enter = MAX(nx, MAX(ny, MAX(nz, 0.0f)));
  return enter <= MIN(fx, MIN(fy, MIN(fz, end)));
}

// Asks for the child's memory, while its siblings are still sorted: large scenes wait for that more than for anything else.
// Leaves without triangles ask for some packet: a load that is not there costs nothing.
static inline void prefetch_child(const SceneData *scene, const uint word) {
  const bool leaf = (word & LEAF_FLAG) != 0u;
  const __global char *packet = (const __global char *)(scene->packets + (word & LEAF_PACKET_MASK));
  const __global char *node = (const __global char *)(scene->nodes + word);
  const __global char *at = leaf ? packet : node;
  PREFETCH(at);
  PREFETCH(at + 64);
  PREFETCH(at + 128);
  PREFETCH(at + 192);
  PREFETCH(at + (leaf ? 256 : 192));
}

// The nearest child that is met, or NO_CHILD; the others wait on the stack, the nearer the later.
static inline uint visit_node(const SceneData *scene, const __global Node8 *node, const WideRay *w, const float end, Stack *stack) {
  float8 enter[1];
  uint mask = lane_mask(meet_boxes(node, w, end, enter));
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
