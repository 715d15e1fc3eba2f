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

// Moves the paths that go on to the front of as few vectors as hold them, where that spares one; those that have ended bring what they
// have.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void pack_paths16(Batch16 *batch) {
  const uint alive = alive_in16(batch), packed = (alive + LANES - 1u) / LANES;
  if (packed == batch->vectors) return;
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

// Rays to lights that vectors of paths wait for go together where any go together: each as if it were alone, whoever waited with it, so
// that they are packed into as few vectors as hold them. hit: those of each vector that meet anything, a bit a lane.
static inline void follow_packed16(const SceneData *scene, const uint vectors, const Waiting16 *waiting, uint *hit) {
  float16 rows[ROWS_OF(Ray16)][VECTORS + 1u];
  uint count = 0u;
  for (uint w = 0u; w < vectors; w++) {
    const uint bits = mask16(waiting[w].lit);
    const float16 *from = (const float16 *)&waiting[w].rays.ray;
    for (uint row = 0u; row < ROWS_OF(Ray16); row++) store_lanes16(from[row], bits, (float *)rows[row] + count);
    count += POPCOUNT(bits);
  }
  for (uint w = 0u; w * LANES < count; w++) {
    Ray16 ray;
    for (uint row = 0u; row < ROWS_OF(Ray16); row++) ((float16 *)&ray)[row] = rows[row][w];
    hit[w] = mask16(occluded16(scene, true, &ray, lanes_from(0u, count - w * LANES)));
  }
}

// The waiting lanes whose rays meet anything, of each vector.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void occlude_packed16(const SceneData *scene, const uint vectors, const Waiting16 *waiting,
                                                             Mask16 *found) {
  uint hit[VECTORS + 1u], at = 0u, rays = 0u, some = 0u;
  for (uint w = 0u; w < vectors; w++) {
    const uint count = POPCOUNT(mask16(waiting[w].lit));
    rays += count;
    some += count ? 1u : 0u;
  }
  if (rays + LANES > some * LANES) {
    for (uint w = 0u; w < vectors; w++)
      if (any16(waiting[w].lit)) found[w] = occluded16(scene, true, &waiting[w].rays.ray, waiting[w].lit);
    return;
  }
  follow_packed16(scene, vectors, waiting, hit);
  for (uint w = 0u; w < vectors; w++) {
    const uint bits = mask16(waiting[w].lit), next = hit[at / LANES] | hit[at / LANES + 1u] << LANES;
    found[w] = lanes_of_bits(deposit_bits(next >> at % LANES, bits));
    at += POPCOUNT(bits);
  }
}

#if PENUMBRA_LARGE_TREES
// What the rays of all vectors meet.
static inline void fly_batch16(const SceneData *scene, Batch16 *batch, Wing16 *wings) {
  for (uint w = 0u; w < batch->vectors; w++) {
    wings[w].rays = &batch->paths[w].ray;
    wings[w].on = batch->on[w];
  }
  fly16(scene, wings, batch->vectors, false);
}

// The same on their own ways.
static inline void occlude_flying16(const SceneData *scene, const uint vectors, const Waiting16 *waiting, Wing16 *wings,
                                    Mask16 *found) {
  uint of[VECTORS], count = 0u;
  for (uint w = 0u; w < vectors; w++) {
    if (!any16(waiting[w].lit)) continue;
    of[count] = w;
    wings[count].rays = &waiting[w].rays.ray;
    wings[count++].on = waiting[w].lit;
  }
  if (count) fly16(scene, wings, count, true);
  for (uint i = 0u; i < count; i++) found[of[i]] = wings[i].found;
}
#endif

// Light that the vectors wait for, but what is in the shade.
static inline void gather_waiting16(const __global Params *params, Batch16 *batch, const Mask16 *found, Waiting16 *waiting) {
  for (uint w = 0u; w < batch->vectors; w++) {
    Waiting16 *at = waiting + w;
    if (!any16(at->smooth)) continue;
    arrive16(&at->rays, at->lit & ~found[w], batch->paths + w, &at->direct);
    gather_light16(params, at, batch->paths + w);
  }
}

// All paths of a batch, from their camera rays to their ends: some end by leaving the scene, others by what they meet.
static inline void trace_batch16(const SceneData *scene, const __global Params *params, Batch16 *batch) {
  const uint lights = direct_count(scene, params);
  Waiting16 waiting[VECTORS];
  Mask16 found[VECTORS];
  Ahead16 ahead;
#if PENUMBRA_LARGE_TREES
  Wing16 wings[VECTORS];
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
    pack_paths16(batch);
    draw_ahead16(params, batch->samplers, batch->on, batch->vectors, bounce, &ahead);
    for (uint w = 0u; w < batch->vectors; w++) {
      const Numbers16 numbers = numbers_of16(&ahead, batch->samplers, w);
      batch->on[w] = shade16(scene, params, &numbers, bounce, lights, batch->on[w], batch->paths + w, waiting + w);
    }
    if (any_together16(params)) occlude_packed16(scene, batch->vectors, waiting, found);
#if PENUMBRA_LARGE_TREES
    else occlude_flying16(scene, batch->vectors, waiting, wings, found);
#endif
    gather_waiting16(params, batch, found, waiting);
    pack_paths16(batch);
  }
}
