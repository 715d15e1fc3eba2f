// The sampler that PENUMBRA_SAMPLER names, behind the one interface of sampler.h. Element `element` of a dimension is a pure
// function of (seed, pixel, replicate, element, dimension): tiles, launches and order change nothing.
#include "sampling/sampler.h"
#include "sampling/strata.cl"
#include "sampling/owen.cl"
#include "sampling/warp.cl"

#if PENUMBRA_SAMPLER == SAMPLER_REGULAR
#include "sampling/regular.cl"
#define DRAW_1D regular_1d
#define DRAW_2D regular_2d
#endif
#if PENUMBRA_SAMPLER == SAMPLER_RANDOM || PENUMBRA_SAMPLER == SAMPLER_INDEPENDENT
#include "sampling/independent.cl"
#define DRAW_1D independent_1d
#define DRAW_2D independent_2d
#endif
#if PENUMBRA_SAMPLER == SAMPLER_STRATIFIED || PENUMBRA_SAMPLER == SAMPLER_JITTERED
#include "sampling/stratified.cl"
#define DRAW_1D jittered_1d
#endif
#if PENUMBRA_SAMPLER == SAMPLER_STRATIFIED
#define DRAW_2D stratified_2d
#endif
#if PENUMBRA_SAMPLER == SAMPLER_JITTERED
#define DRAW_2D jittered_2d
#endif
#if PENUMBRA_SAMPLER == SAMPLER_SOBOL
#include "sampling/sobol.cl"
#define DRAW_1D sobol_1d
#define DRAW_2D sobol_2d
#endif
#if PENUMBRA_SAMPLER == SAMPLER_BLUE_NOISE
#include "sampling/blue_noise.cl"
#define DRAW_1D blue_noise_1d
#define DRAW_2D blue_noise_2d
#endif

// For a pixel (x, y) of the full frame.
static inline Sampler sampler_start(const __global Params *params, const uint x, const uint y, const uint replicate) {
  Sampler s;
  s.key = pixel_key(params->seed, x, y, replicate);
  s.frame_key = 0ul;
  s.index = 0ul;
  s.reversed = 0u;
  s.strata = params->strata;
  s.passes = 0u;
  s.digits = 0u;
  s.stride = 1u;
  s.rank = 0ul;
#if PENUMBRA_PICK_FREEZE
  s.other_groups = params->options >> OPTION_OTHER_SHIFT;
#endif
#if PENUMBRA_SAMPLER == SAMPLER_REGULAR
  s.stride = params->replicate_count;
  s.strata = params->strata * s.stride;
  s.rank = replicate;
#endif
#if PENUMBRA_SAMPLER == SAMPLER_BLUE_NOISE
  s.frame_key = hash_combine(mix64(params->seed ^ FRAME_SALT), replicate);
  s.passes = params->log2_samples;
  s.digits = bits_of(MAX(params->film_width, params->film_height));
  s.rank = z_curve(x, y);
#endif
  return s;
}

static inline void sampler_next(Sampler *s, const ulong index) {
#if PENUMBRA_SAMPLER == SAMPLER_REGULAR
  s->index = index * s->stride + s->rank;
#else
  s->index = index;
#endif
#if PENUMBRA_SAMPLER == SAMPLER_SOBOL
  s->reversed = REVERSE_BITS((uint)index);
#endif
}

// random: point `k` of those that fell into the pixel with index `index`; each is independent of all others.
static inline void sampler_next_of(Sampler *s, const ulong index, const uint k) {
  s->index = hash_combine(index, k);
}

// Measuring what a group of dimensions adds to the noise (sensitivity.py) has some groups draw from a second stream, for which
// there is room in `other`, and counts the numbers that are drawn. Everywhere else this is the sampler itself.
static inline const Sampler *stream_of(const Sampler *s, const ulong dim, const uint numbers, Sampler *other) {
#if PENUMBRA_COUNT_DRAWS
  s->drawn[drawn_of(dim)] += numbers;
#endif
#if PENUMBRA_PICK_FREEZE
  if (s->other_groups & group_of(dim)) {
    *other = *s;
    other->key = hash_combine(s->key, OTHER_SALT);
    other->frame_key = hash_combine(s->frame_key, OTHER_SALT);
    return other;
  }
#endif
  return s;
}

static inline float sample_1d(const Sampler *s, const ulong dim) {
  Sampler other;
  return DRAW_1D(stream_of(s, dim, 1u, &other), dim, s->index, s->strata);
}
static inline float2 sample_2d(const Sampler *s, const ulong dim) {
  Sampler other;
  return DRAW_2D(stream_of(s, dim, 2u, &other), dim, s->index, s->strata);
}

// Planned elements where each sample draws m; saturates, since blocks are cut at MAX_STRATA anyway.
static inline uint planned(const Sampler *s, const uint m) {
  return s->strata > 0xffffffffu / m ? 0xffffffffu : s->strata * m;
}

static inline float sample_1d_of(const Sampler *s, const ulong dim, const uint j, const uint m) {
  if (m == 1u) return sample_1d(s, dim);
  Sampler other;
  return DRAW_1D(stream_of(s, dim, 1u, &other), dim, s->index * m + j, planned(s, m));
}
static inline float2 sample_2d_of(const Sampler *s, const ulong dim, const uint j, const uint m) {
  if (m == 1u) return sample_2d(s, dim);
  Sampler other;
  return DRAW_2D(stream_of(s, dim, 2u, &other), dim, s->index * m + j, planned(s, m));
}
