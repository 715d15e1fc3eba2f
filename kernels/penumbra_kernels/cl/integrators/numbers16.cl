// Where the numbers of a bounce come from. Those that nearly every hit takes are drawn for a whole batch before it is known what was
// hit: one after the other they would wait for their own steps. Only where all lanes draw at once, which leaves bits alone.
#include "layout.h"
#include "sampling/sampler16.cl"

// Of all vectors, a light's point and a direction each, or one of them.
typedef struct {
  bool lights, scatter;
  Point16 points[2u * VECTORS];
} Ahead16;

// Of one vector. What was not drawn ahead is null, and drawn when it is asked for.
typedef struct {
  const Sampler16 *samples;
  const Point16 *light, *direction;
} Numbers16;

static inline void draw_ahead16(const __global Params *params, const Sampler16 *samples, const Mask16 *on, const uint vectors,
                                const uint bounce, Ahead16 *ahead) {
  ahead->lights = ahead->scatter = false;
#if PENUMBRA_ROWS
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT
  ahead->lights = bounce <= params->max_bounces && params->shadow_rays == 1u && !(params->options & OPTION_ALL_LIGHTS);
#endif
#if PENUMBRA_INDIRECT
  ahead->scatter = bounce < params->max_bounces;
#endif
  const uint count = (ahead->lights ? 1u : 0u) + (ahead->scatter ? 1u : 0u);
  if (count) sample_pairs16(samples, on, vectors, DIM_BOUNCE(bounce, ahead->lights ? SLOT_LIGHT : SLOT_DIRECTION), count, ahead->points);
#endif
}

static inline Numbers16 numbers_of16(const Ahead16 *ahead, const Sampler16 *samples, const uint vector) {
  const uint first = ahead->lights && ahead->scatter ? 2u * vector : vector;
  const uint last = ahead->lights && ahead->scatter ? first + 1u : first;
  Numbers16 numbers;
  numbers.samples = samples + vector;
  numbers.light = ahead->lights ? ahead->points + first : (const Point16 *)0;
  numbers.direction = ahead->scatter ? ahead->points + last : (const Point16 *)0;
  return numbers;
}
