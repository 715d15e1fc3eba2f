// The numbers of sixteen samples, a lane each: what sampler.cl gives them. The lanes hold 2^shift consecutive samples of each of some
// pixels and replicates, one after the other; lanes that are off draw nothing, and what they get means nothing.
#include "base/lanes16.cl"
#include "sampling/sampler.cl"
#include "sampling/hash16.cl"
#include "sampling/sobol16.cl"

// Whether all lanes draw a number at once; where not, one after the other.
#define PENUMBRA_ROWS                                                                     \
  ((PENUMBRA_SAMPLER == SAMPLER_SOBOL || PENUMBRA_SAMPLER == SAMPLER_INDEPENDENT) &&      \
   !PENUMBRA_PICK_FREEZE && !PENUMBRA_COUNT_DRAWS)

typedef struct {
  const Sampler *samplers;  // one a pixel and replicate
  ulong first;              // index of their first sample here
  uint shift;
#if PENUMBRA_ROWS
  ulong16 keys;   // the samplers', a lane each
  uint16 index;   // of each lane's sample, its low half
  bool rows;      // they all have the same high half
#endif
} Sampler16;

static inline Sampler16 sampler_start16(const Sampler *samplers, const uint count, const ulong first, const uint shift) {
  Sampler16 s;
  s.samplers = samplers;
  s.first = first;
  s.shift = shift;
#if PENUMBRA_ROWS
  s.rows = ((first + LANES) >> 32) == (first >> 32);
  s.index = (uint)first + (as_uint16(LANE_NUMBERS) & ((1u << shift) - 1u));
  s.keys = samplers->key;
  if (shift < LANE_LEVELS) {
    ulong *keys = (ulong *)&s.keys;
    for (uint k = 0u; k < count << shift; k++) keys[k] = samplers[k >> shift].key;
  }
#endif
  return s;
}

static inline Sampler lane_sampler(const Sampler16 *s, const uint k) {
  Sampler one = s->samplers[k >> s->shift];
  sampler_next(&one, s->first + (k & ((1u << s->shift) - 1u)));
  return one;
}

#if PENUMBRA_ROWS && PENUMBRA_SAMPLER == SAMPLER_SOBOL
static inline ulong16 keys_of(const Sampler16 *s, const ulong dim) {
  const ulong16 keys = hash_combine16(s->keys, dim);
  const ulong epoch = s->first >> 32;
  return epoch ? hash_combine16(keys, epoch) : keys;
}

static inline ulong key_of(const Sampler16 *s, const ulong dim) { return sobol_key(s->samplers, dim, s->first); }

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_1d(const Sampler16 *s, const ulong dim, float16 *x) {
  if (s->shift == LANE_LEVELS) {
    const ulong key = key_of(s, dim);
    *x = sobol_x16(shuffled16(s->index, (uint16)((uint)key)), (uint16)((uint)(key >> 32)));
    return;
  }
  const ulong16 keys = keys_of(s, dim);
  *x = sobol_x16(shuffled16(s->index, low_half16(keys)), high_half16(keys));
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_2d(const Sampler16 *s, const ulong dim, Point16 *p) {
  if (s->shift == LANE_LEVELS) {
    const ulong key = key_of(s, dim), more = mix64(key);
    const uint16 shuffled = shuffled16(s->index, (uint16)((uint)key));
    p->x = sobol_x16(shuffled, (uint16)((uint)(more >> 32)));
    p->y = sobol_y16(shuffled, (uint16)((uint)more));
    return;
  }
  const ulong16 keys = keys_of(s, dim), more = mix64_16(keys);
  const uint16 shuffled = shuffled16(s->index, low_half16(keys));
  p->x = sobol_x16(shuffled, high_half16(more));
  p->y = sobol_y16(shuffled, low_half16(more));
}
#endif

#if PENUMBRA_ROWS && PENUMBRA_SAMPLER == SAMPLER_INDEPENDENT
static inline ulong16 random_bits16(const Sampler16 *s, const ulong dim) {
  const ulong16 element = to_ulong16(s->index) | (s->first & 0xffffffff00000000ul);
  return mix64_16(hash_combine16(s->keys, dim) + HASH_STEP * (element + 1ul));
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_1d(const Sampler16 *s, const ulong dim, float16 *x) {
  *x = uniform_of16(high_half16(random_bits16(s, dim)));
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_2d(const Sampler16 *s, const ulong dim, Point16 *p) {
  const ulong16 bits = random_bits16(s, dim);
  p->x = uniform_of16(high_half16(bits));
  p->y = uniform_of16(low_half16(bits));
}
#endif

// Number j of m that each sample draws.
static inline float16 sample_1d_of16(const Sampler16 *s, const ulong dim, const uint j, const uint m, const Mask16 on) {
  float16 out = 0.0f;
#if PENUMBRA_ROWS
  if (m == 1u && s->rows) {
    draw_row_1d(s, dim, &out);
    return out;
  }
#endif
  for (LANES_OF(k, on)) {
    const Sampler one = lane_sampler(s, k);
    LANE_F(out, k) = sample_1d_of(&one, dim, j, m);
  }
  return out;
}

static inline Point16 sample_2d_of16(const Sampler16 *s, const ulong dim, const uint j, const uint m, const Mask16 on) {
  Point16 out;
  out.x = out.y = 0.0f;
#if PENUMBRA_ROWS
  if (m == 1u && s->rows) {
    draw_row_2d(s, dim, &out);
    return out;
  }
#endif
  for (LANES_OF(k, on)) {
    const Sampler one = lane_sampler(s, k);
    const float2 u = sample_2d_of(&one, dim, j, m);
    LANE_F(out.x, k) = u.x;
    LANE_F(out.y, k) = u.y;
  }
  return out;
}

static inline float16 sample_1d16(const Sampler16 *s, const ulong dim, const Mask16 on) { return sample_1d_of16(s, dim, 0u, 1u, on); }
static inline Point16 sample_2d16(const Sampler16 *s, const ulong dim, const Mask16 on) { return sample_2d_of16(s, dim, 0u, 1u, on); }
