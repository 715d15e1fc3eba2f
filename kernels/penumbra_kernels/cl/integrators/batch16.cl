// A batch of paths, sixteen to a vector of lanes. Paths end at different bounces: those that go on are packed into as few vectors as
// hold them, whoever they were with before. Lanes never meet, so that changes no path.
#include "integrators/paths16.cl"

typedef struct {
  Samples samples;
  Paths16 paths[VECTORS];
  Sampler16 samplers[VECTORS];     // of the paths' samples
  Mask16 on[VECTORS];
  uint held[VECTORS];              // a bit a lane that has a path, ended or not
  uint vectors;                    // in use
  bool moved;                      // paths are not in their numbers' lanes any more
  PathSamples16 results[VECTORS];  // by the samples' numbers
} Batch16;

#define ROWS_OF(type) ((uint)(sizeof(type) / sizeof(float16)))

// Paths that have ended bring what they have. Row by row: compilers would scatter a path's rows, which takes longer.
static inline void end_paths16(const Paths16 *p, const uint bits, PathSamples16 *results) {
  const uint *from = (const uint *)&p->result;
  for (uint row = 0u; row < ROWS_OF(PathSamples16); row++) {
    for (uint left = bits; left; left &= left - 1u) {
      const uint k = CTZ(left), number = LANE_U(p->number, k);
      ((uint *)(results + number / LANES))[row * LANES + number % LANES] = from[row * LANES + k];
    }
  }
}

// The first `count` paths of the batch are on: those of vector w.
static inline void hold_paths16(Batch16 *batch, const uint w, const uint count) {
  const uint some = MIN(count - w * LANES, LANES);
  batch->on[w] = lanes_from(0u, some);
  batch->held[w] = (1u << some) - 1u;
  sampler_start16(&batch->samples, batch->paths[w].number, some, batch->samplers + w);
}

static inline uint alive_in16(const Batch16 *batch) {
  uint alive = 0u;
  for (uint w = 0u; w < batch->vectors; w++) alive += POPCOUNT(mask16(batch->on[w]));
  return alive;
}

// Moves the paths that go on to the front of as few vectors as hold them; those that have ended bring what they have.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void pack_paths16(Batch16 *batch, const uint alive) {
  const uint packed = (alive + LANES - 1u) / LANES;
  float16 rows[ROWS_OF(Paths16)][VECTORS + 1u];
  uint at = 0u;
  for (uint w = 0u; w < batch->vectors; w++) {
    const uint bits = mask16(batch->on[w]);
    const float16 *from = (const float16 *)(batch->paths + w);
    if (batch->moved) end_paths16(batch->paths + w, batch->held[w] & ~bits, batch->results);
    else batch->results[w] = batch->paths[w].result;  // of those that go on it will be written over
    for (uint row = 0u; row < ROWS_OF(Paths16); row++) store_lanes16(from[row], bits, (float *)rows[row] + at);
    at += POPCOUNT(bits);
  }
  for (uint w = 0u; w < packed; w++) {
    float16 *to = (float16 *)(batch->paths + w);
    for (uint row = 0u; row < ROWS_OF(Paths16); row++) to[row] = rows[row][w];
    hold_paths16(batch, w, alive);
  }
  batch->vectors = packed;
  batch->moved = true;
}

#if PENUMBRA_LARGE_TREES
#define FLOWN VECTORS  // vectors whose rays and hits are kept at once

// What the rays of all vectors meet.
static inline void fly_batch16(const SceneData *scene, Batch16 *batch, Wing16 *wings) {
  for (uint w = 0u; w < batch->vectors; w++) {
    wings[w].rays = &batch->paths[w].ray;
    wings[w].on = batch->on[w];
  }
  fly16(scene, wings, batch->vectors, false);
}

// Light that the vectors wait for.
static inline void gather_waiting16(const SceneData *scene, const __global Params *params, Batch16 *batch, Waiting16 *waiting,
                                    Wing16 *wings) {
  uint of[VECTORS], count = 0u;
  for (uint w = 0u; w < batch->vectors; w++) {
    if (!any16(waiting[w].lit)) continue;
    of[count] = w;
    wings[count].rays = &waiting[w].rays.ray;
    wings[count++].on = waiting[w].lit;
  }
  if (count) fly16(scene, wings, count, true);
  for (uint i = 0u; i < count; i++) {
    Waiting16 *at = waiting + of[i];
    Paths16 *p = batch->paths + of[i];
    arrive16(&at->rays, at->lit & ~wings[i].found, p, &at->direct);
    gather_light16(params, at, p);
  }
}
#else
#define FLOWN 1u
#endif

static inline void pack_where_less16(Batch16 *batch) {
  const uint alive = alive_in16(batch);
  if (alive + LANES <= batch->vectors * LANES) pack_paths16(batch, alive);
}

// All paths of a batch, from their camera rays to their ends: some end by leaving the scene, others by what they meet.
static inline void trace_batch16(const SceneData *scene, const __global Params *params, Batch16 *batch) {
  const uint lights = direct_count(scene, params);
  Waiting16 waiting[FLOWN];
#if PENUMBRA_LARGE_TREES
  Wing16 wings[FLOWN];
#endif
  for (uint bounce = 0u; batch->vectors; bounce++) {
    const bool together = together16(params, bounce == 0u);
#if PENUMBRA_LARGE_TREES
    if (!together) fly_batch16(scene, batch, wings);
#endif
    for (uint w = 0u; w < batch->vectors; w++) {
      Paths16 *p = batch->paths + w;
      const Mask16 on = batch->on[w];
      if (together) batch->on[w] = on & intersect16(scene, &p->ray, on, &p->hit);
#if PENUMBRA_LARGE_TREES
      if (!together) {
        p->hit = wings[w].hit;
        batch->on[w] = on & wings[w].found;
      }
#endif
      meet16(scene, params, batch->on[w], on, p);
    }
    pack_where_less16(batch);
    for (uint w = 0u; w < batch->vectors; w++)
      batch->on[w] = shade16(scene, params, batch->samplers + w, bounce, lights, batch->on[w], batch->paths + w, waiting + w % FLOWN);
#if PENUMBRA_LARGE_TREES
    gather_waiting16(scene, params, batch, waiting, wings);
#endif
    pack_where_less16(batch);
  }
}
