// Several paths at once, for CPUs: each step of a bounce is taken for all of them before the next one. A path's own steps wait
// for each other: divisions, roots, loads, branches that were guessed wrong. The same step of another path does not, so a
// processor that executes out of order works on both. Paths never meet: each gives the bits that trace_path gives.
// On GPUs, whose threads hide waiting from each other, one path at a time.
#include "integrators/path.cl"

#if PENUMBRA_DEVICE_GPU
#define PATHS 1u

static inline uint paths_from(const ulong first, const uint left) { return 1u; }

static inline void trace_paths(const SceneData *scene, const __global Params *params, const Sampler *samplers,
                               const uint count, Path *paths) {
  trace_path(scene, params, samplers, paths);
}
#else
#define PATHS 8u

// How many of the `left` samples of a pixel from `first` on are taken together: up to a multiple of PATHS, so that all of them
// find their numbers in the same rows (sampling/ahead.cl).
static inline uint paths_from(const ulong first, const uint left) {
  const uint room = PATHS - (uint)first % PATHS;
  return MIN(room, left);
}

// The paths that go on, in their order.
typedef struct {
  uint path[PATHS];
  uint count;
} Live;

// Kept without a branch: whether a path ends is as good as random.
static inline void keep(Live *live, const uint path, const bool goes_on) {
  live->path[live->count] = path;
  live->count += goes_on ? 1u : 0u;
}

static inline void shine_all(const SceneData *scene, const __global Params *params, const Sampler *samplers,
                             const uint bounce, const uint n, const Live *live, Path *paths, const Vertex *at) {
  LightRay rays[PATHS];
  Live lit;
  lit.count = 0u;
  for (uint k = 0u; k < live->count; k++) {
    const uint i = live->path[k];
    keep(&lit, i, path_aim(scene, params, samplers + i, bounce, n, paths + i, at + i, rays + i));
  }
  for (uint k = 0u; k < lit.count; k++) path_shine(scene, rays + lit.path[k], paths + lit.path[k]);
}

// `count` <= PATHS of them, from their camera rays to their ends.
static inline void trace_paths(const SceneData *scene, const __global Params *params, const Sampler *samplers,
                               const uint count, Path *paths) {
  const uint lights = direct_count(scene, params);
  Vertex at[PATHS];
  Live live;
  live.count = count;
  for (uint i = 0u; i < count; i++) live.path[i] = i;
  for (uint bounce = 0u; live.count; bounce++) {
    uint n = live.count;
    live.count = 0u;
    for (uint k = 0u; k < n; k++) {
      const uint i = live.path[k];
      keep(&live, i, path_meet(scene, params, paths + i, at + i));
    }
    n = live.count;
    live.count = 0u;
    for (uint k = 0u; k < n; k++) {
      const uint i = live.path[k];
      keep(&live, i, path_look(scene, params, bounce, paths + i, at + i));
    }
    for (uint j = 0u; j < lights; j++) shine_all(scene, params, samplers, bounce, j, &live, paths, at);
    n = live.count;
    live.count = 0u;
    for (uint k = 0u; k < n; k++) {
      const uint i = live.path[k];
      path_gather(params, paths + i, at + i);
      keep(&live, i, path_scatter(scene, params, samplers + i, bounce, paths + i, at + i));
    }
  }
}
#endif
