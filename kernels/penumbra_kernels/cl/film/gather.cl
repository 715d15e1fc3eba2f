// What a sum node gathers for one pixel of one replicate: pairwise sums over its samples, counts, layers.
#include "integrators/path_sample.h"

#define MAX_LEVELS 9  // nodes of up to 2^8 samples are summed here, pairwise

// Adds sample number i to the partial sums of a binary tree over sample indices: after 2^k samples level k holds their sum,
// each parent the sum of its two children in index order.
// value: of samples from i on, 2^level of them, which is a multiple of that.
static inline void tree_add_from(float4 *levels, uint level, const uint i, float4 value) {
  for (; (i >> level) & 1u; level++) value = levels[level] + value;
  levels[level] = value;
}

static inline void tree_add(float4 *levels, const uint i, const float4 value) { tree_add_from(levels, 0u, i, value); }

static inline uint level_of(const uint count) { return CTZ(count); }

static inline bool is_valid(const float3 c) {
  return is_finite(c.x) && is_finite(c.y) && is_finite(c.z) && c.x >= 0.0f && c.y >= 0.0f && c.z >= 0.0f;
}

// What a node gathers for one pixel and replicate.
typedef struct {
  float4 levels[MAX_LEVELS];
  uint taken, lit, rejected, rejected_in, rays;
#if PENUMBRA_LAYERS
  float4 albedo_depth[MAX_LEVELS];
  float4 normal[MAX_LEVELS];
  uint object_id;
#endif
} Gather;

// One camera path's value; counts it.
static inline float4 path_value(const PathSample *path, const float weight, Gather *gather) {
  gather->rays += path->rays;
  const float3 c = path->radiance;
  if (!is_valid(c)) {
    gather->rejected++;
    gather->rejected_in |= path->effects;
    return (float4)(0.0f);
  }
  gather->taken++;
  gather->lit += max3(c) > 0.0f ? 1u : 0u;
  return (float4)(c * weight, path->alpha * weight);
}

static inline void gather_start(Gather *gather) {
  gather->taken = gather->lit = gather->rejected = gather->rejected_in = gather->rays = 0u;
  gather->levels[0] = (float4)(0.0f);
#if PENUMBRA_LAYERS
  gather->albedo_depth[0] = gather->normal[0] = (float4)(0.0f);
  gather->object_id = 0u;
#endif
}

// A leaf of the tree: a sample's value, or where indices around it are not taken its sum with their zeros, which turns -0
// into 0 as any larger node does.
static inline float4 leaf(const float4 value, const bool thinned) { return thinned ? value + (float4)(0.0f) : value; }

static inline void gather_layers(Gather *gather, const uint i, const PathSample *path, const bool thinned) {
#if PENUMBRA_LAYERS
  tree_add(gather->albedo_depth, i, leaf((float4)(path->albedo, path->depth), thinned));
  tree_add(gather->normal, i, leaf((float4)(path->normal, 0.0f), thinned));
  if (i == 0) gather->object_id = path->object_id;
#endif
}

// Writes the node of `count` samples: the entry of each plane that `out` is in the first one, planes `stride` words apart. layers:
// null where there are none.
static inline void gather_write(const Gather *gather, const uint count, const uint stride, __global Layers *layers,
                                __global uint *out) {
  const uint top = level_of(MAX(count, 1u));
  const size_t plane = stride;
  const float4 sum = gather->levels[top];
  out[SUM_RGBA * plane] = as_uint(sum.x);
  out[(SUM_RGBA + 1u) * plane] = as_uint(sum.y);
  out[(SUM_RGBA + 2u) * plane] = as_uint(sum.z);
  out[(SUM_RGBA + 3u) * plane] = as_uint(sum.w);
  out[SUM_TAKEN * plane] = gather->taken;
  out[SUM_LIT * plane] = gather->lit;
  out[SUM_REJECTED * plane] = gather->rejected;
  out[SUM_REJECTED_IN * plane] = gather->rejected_in;
  out[SUM_RAYS * plane] = gather->rays;
#if PENUMBRA_LAYERS
  const float4 albedo_depth = gather->albedo_depth[top], normal = gather->normal[top];
  layers->albedo_depth[0] = albedo_depth.x;
  layers->albedo_depth[1] = albedo_depth.y;
  layers->albedo_depth[2] = albedo_depth.z;
  layers->albedo_depth[3] = albedo_depth.w;
  layers->normal[0] = normal.x;
  layers->normal[1] = normal.y;
  layers->normal[2] = normal.z;
  layers->object_id = gather->object_id;
#endif
}
