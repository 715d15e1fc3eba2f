// The numbers of sixteen samples, a lane each: what sampler.cl gives them. The lanes hold samples of one pixel and replicate, or of
// several; lanes that are off draw nothing, and what they get means nothing.
#include "base/lanes16.cl"
#include "sampling/sampler.cl"
#include "sampling/hash16.cl"
#include "sampling/sobol16.cl"
#include "sampling/strata16.cl"

// Whether all lanes draw a number at once; where not, one after the other.
#define PENUMBRA_STRATA (PENUMBRA_SAMPLER == SAMPLER_STRATIFIED || PENUMBRA_SAMPLER == SAMPLER_JITTERED)
#define PENUMBRA_ROWS                                                                                        \
  ((PENUMBRA_SAMPLER == SAMPLER_SOBOL || PENUMBRA_SAMPLER == SAMPLER_INDEPENDENT || PENUMBRA_STRATA) &&      \
   !PENUMBRA_PICK_FREEZE && !PENUMBRA_COUNT_DRAWS)

#define FEW_SAMPLERS 8u

// Samples that are traced together, by their numbers among them: those of a pixel and replicate stand together, with consecutive
// indices, the pixels in their order.
typedef struct {
  const Sampler *samplers;  // one a pixel and replicate
  uchar of[BATCH];          // which of them is each sample's
  ulong index[BATCH];       // of each sample
#if PENUMBRA_ROWS
  bool even;    // there are at most FEW_SAMPLERS, each of 2^shift samples from the same index on
  uint shift;
  ulong8 keys;  // theirs, where that is so
#endif
} Samples;

typedef struct {
  const Samples *samples;
  uint16 number;  // of each lane's sample
#if PENUMBRA_ROWS
  const Sampler *first;  // the first lane's sampler
  bool one;              // which is that of all lanes
  bool rows;             // the indices' high halves are 0, and the lanes have strata in common
  uint16 low;            // of the indices, their low halves
  uint16 element;        // what draw_row_1d and _2d take for these
  uint16 word;           // where the samplers are even: of their keys, the low half of each lane's; the high one follows
  ulong16 keys;          // where they are not, and several: a lane each
#endif
} Sampler16;

#if PENUMBRA_ROWS
static inline uint16 element_of16(const uint16 low) {
#if PENUMBRA_SAMPLER == SAMPLER_SOBOL
  return reverse_bits16(low);
#else
  return low;
#endif
}
#endif

#if PENUMBRA_ROWS && PENUMBRA_STRATA
// Whether the samples of all lanes lie in one block of strata, and few strata are one sampler's.
static inline bool share_strata16(const Samples *samples, const uint16 number, const uint count, const Sampler16 *s) {
  const ulong start = samples->index[LANE_U(number, 0u)];
  const Stratum t = stratum_of(start, s->first->strata);
  const ulong begin = start - t.offset;
  if (s->one) return samples->index[LANE_U(number, count - 1u)] - begin < t.count;
  bool alike = t.count > SMALL_COUNT;
  for (uint k = 0u; k < count && alike; k++) {
    const uint at = LANE_U(number, k);
    alike = samples->index[at] - begin < t.count && samples->samplers[samples->of[at]].strata == s->first->strata;
  }
  return alike;
}
#endif

// number: of the samples of the `count` lanes that are on, which are the first ones; rising.
static inline void sampler_start16(const Samples *samples, const uint16 number, const uint count, Sampler16 *s) {
  s->samples = samples;
  s->number = number;
#if PENUMBRA_ROWS
  const uint start = LANE_U(s->number, 0u), end = LANE_U(s->number, count - 1u), of = samples->of[start];
  const ulong index = samples->index[start];
  s->first = samples->samplers + of;
  s->one = of == samples->of[end];
  s->rows = (index | samples->index[end]) >> 32 == 0ul;
  s->low = number + ((uint)index - start);
  if (!s->one && samples->even) {
    s->low = (uint)samples->index[0] + (number & ((1u << samples->shift) - 1u));
    s->word = (number >> samples->shift) * 2u;
  } else if (!s->one) {
    s->keys = s->first->key;
    for (uint k = 0u; k < count; k++) {
      const uint at = LANE_U(s->number, k);
      s->rows = s->rows && samples->index[at] >> 32 == 0ul;
      LANE_U(s->low, k) = (uint)samples->index[at];
      ((ulong *)&s->keys)[k] = samples->samplers[samples->of[at]].key;
    }
  }
  s->element = element_of16(s->low);
#if PENUMBRA_STRATA
  s->rows = s->rows && share_strata16(samples, number, count, s);
#endif
#endif
}

static inline Sampler lane_sampler(const Sampler16 *s, const uint k) {
  const uint number = LANE_U(s->number, k);
  Sampler one = s->samples->samplers[s->samples->of[number]];
  sampler_next(&one, s->samples->index[number]);
  return one;
}

#if PENUMBRA_ROWS && PENUMBRA_SAMPLER == SAMPLER_SOBOL
static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_1d(const Sampler16 *s, const ulong dim, const uint16 *element, float16 *x) {
  if (s->one) {
    const ulong key = hash_combine(s->first->key, dim);
    *x = sobol_x16(shuffled16(*element, (uint16)((uint)key)), (uint16)((uint)(key >> 32)));
    return;
  }
  uint16 low, high;
  if (s->samples->even) {
    const uint16 keys = as_uint16(hash_combine8(s->samples->keys, dim));
    low = words_of16(keys, s->word);
    high = words_of16(keys, s->word + 1u);
  } else {
    const ulong16 keys = hash_combine16(s->keys, dim);
    low = low_half16(keys);
    high = high_half16(keys);
  }
  *x = sobol_x16(shuffled16(*element, low), high);
}

// Points of `count` pairs of a family, from the `step` of the first on. pixel: in its order.
static inline void draw_pairs_of_one(const ulong key, const ulong step, const bool pixel, const uint count, const uint16 element,
                                     Point16 *p) {
  uint16 shuffled = shuffled16(element, (uint16)((uint)key));
  if (pixel) shuffled = joined16(shuffled);
  ulong state = key * step;
  for (uint i = 0u; i < count; i++, state *= NEXT_PAIR) {
    p[i].x = sobol_x16(shuffled, (uint16)((uint)(state >> 32)));
    p[i].y = sobol_y16(shuffled, (uint16)((uint)(state * NEXT_SEED >> 32)));
  }
}

// The same of even samplers. word: in their keys, of each lane's low half.
static inline void draw_pairs_of_even(const ulong8 keys, const uint16 word, const ulong step, const bool pixel, const uint count,
                                      const uint16 element, Point16 *p) {
  uint16 shuffled = shuffled16(element, words_of16(as_uint16(keys), word));
  if (pixel) shuffled = joined16(shuffled);
  ulong8 state = keys * step;
  for (uint i = 0u; i < count; i++, state *= NEXT_PAIR) {
    p[i].x = sobol_x16(shuffled, words_of16(as_uint16(state), word + 1u));
    p[i].y = sobol_y16(shuffled, words_of16(as_uint16(state * NEXT_SEED), word + 1u));
  }
}

// The same with a key a lane.
static inline void draw_pairs_of_each(const ulong16 keys, const ulong step, const bool pixel, const uint count, const uint16 element,
                                      Point16 *p) {
  uint16 shuffled = shuffled16(element, low_half16(keys));
  if (pixel) shuffled = joined16(shuffled);
  ulong16 state = keys * step;
  for (uint i = 0u; i < count; i++, state *= NEXT_PAIR) {
    p[i].x = sobol_x16(shuffled, high_half16(state));
    p[i].y = sobol_y16(shuffled, high_half16(state * NEXT_SEED));
  }
}

// Points of `count` pairs of a family, of `dim` and of those that follow (SLOT_DIRECTION on SLOT_LIGHT), of each vector: elements of
// their own, or all `element`.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_pairs(const Sampler16 *s, const uint vectors, const ulong dim, const uint count,
                                                       const uint16 *element, Point16 *p) {
  const ulong family = family_of(dim), step = pair_step(dim);
  const bool pixel = dim == DIM_PIXEL;
  const Sampler *last = (const Sampler *)0;
  ulong key = 0ul;
  for (uint w = 0u; w < vectors; w++, p += count) {
    const uint16 at = element ? *element : s[w].element;
    if (s[w].one) {
      if (s[w].first != last) key = hash_combine(s[w].first->key, family);
      last = s[w].first;
      draw_pairs_of_one(key, step, pixel, count, at, p);
    } else if (s[w].samples->even) {
      draw_pairs_of_even(hash_combine8(s[w].samples->keys, family), s[w].word, step, pixel, count, at, p);
    } else {
      draw_pairs_of_each(hash_combine16(s[w].keys, family), step, pixel, count, at, p);
    }
  }
}

static inline void draw_row_2d(const Sampler16 *s, const ulong dim, const uint16 *element, Point16 *p) {
  draw_pairs(s, 1u, dim, 1u, element, p);
}
#endif

#if PENUMBRA_ROWS && PENUMBRA_SAMPLER != SAMPLER_SOBOL
// The keys of a dimension, a lane each.
static inline ulong16 keys_of(const Sampler16 *s, const ulong dim) {
  if (s->one) return hash_combine(s->first->key, dim);
  if (!s->samples->even) return hash_combine16(s->keys, dim);
  const uint16 words = as_uint16(hash_combine8(s->samples->keys, dim));
  return to_ulong16(words_of16(words, s->word)) | to_ulong16(words_of16(words, s->word + 1u)) << 32ul;
}

static inline ulong16 element_bits16(const ulong16 keys, const uint16 element) {
  return mix64_16(keys + HASH_STEP * (to_ulong16(element) + 1ul));
}
#endif

#if PENUMBRA_ROWS && PENUMBRA_STRATA
// The strata of elements in one block, after their shuffle. bits: random ones of each.
static inline uint16 strata_of16(const Sampler16 *s, const ulong dim, const uint16 element, uint *count, ulong16 *bits) {
  const uint first = LANE_U(element, 0u);
  const Stratum t = stratum_of(first, s->first->strata);
  const uint16 within = element - (first - t.offset), none = 0u;
  const uint16 offset = within < t.count ? within : none;  // of lanes that are off too
  const ulong16 keys = hash_combine16(keys_of(s, dim), t.block);
  *count = t.count;
  *bits = element_bits16(keys, offset);
  return permute16(offset, t.count, keys);
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_1d(const Sampler16 *s, const ulong dim, const uint16 *element, float16 *x) {
  uint count;
  ulong16 bits;
  const uint16 at = strata_of16(s, dim, *element, &count, &bits);
  *x = stratum_1d16(at, count, uniform_of16(high_half16(bits)));
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_2d(const Sampler16 *s, const ulong dim, const uint16 *element, Point16 *p) {
  uint count;
  ulong16 bits;
  const uint16 at = strata_of16(s, dim, *element, &count, &bits);
  Point16 jitter;
  jitter.x = uniform_of16(high_half16(bits));
  jitter.y = uniform_of16(low_half16(bits));
#if PENUMBRA_SAMPLER == SAMPLER_STRATIFIED
  if (dim == DIM_PIXEL) jitter.x = jitter.y = 0.5f;
#endif
  *p = stratum_2d16(at, count, jitter);
}
#endif

#if PENUMBRA_ROWS && PENUMBRA_SAMPLER == SAMPLER_INDEPENDENT
static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_1d(const Sampler16 *s, const ulong dim, const uint16 *element, float16 *x) {
  *x = uniform_of16(high_half16(element_bits16(keys_of(s, dim), *element)));
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_row_2d(const Sampler16 *s, const ulong dim, const uint16 *element, Point16 *p) {
  const ulong16 bits = element_bits16(keys_of(s, dim), *element);
  p->x = uniform_of16(high_half16(bits));
  p->y = uniform_of16(low_half16(bits));
}
#endif

#if PENUMBRA_ROWS
// Elements of a dimension's sequence that each sample takes m of, the j-th. False where their high half is not 0, or each sample has
// but one.
static inline bool elements16(const Sampler16 *s, const uint j, const uint m, uint16 *element) {
  *element = element_of16(s->low * m + j);
  if (PENUMBRA_STRATA) return false;  // strata of several numbers a sample are others
  return m > 1u && s->rows && !any16(high_half16(to_ulong16(s->low) * (ulong)m + j) != 0u);
}
#endif

// Number j of m that each sample draws, where m > 1 or one lane has to draw after the other.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_any_1d(const Sampler16 *s, const ulong dim, const uint j, const uint m, const Mask16 *on,
                                                        float16 *out) {
#if PENUMBRA_ROWS
  uint16 element;
  if (elements16(s, j, m, &element)) {
    draw_row_1d(s, dim, &element, out);
    return;
  }
#endif
  *out = 0.0f;
  for (LANES_OF(k, *on)) {
    const Sampler one = lane_sampler(s, k);
    LANE_F(*out, k) = sample_1d_of(&one, dim, j, m);
  }
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void draw_any_2d(const Sampler16 *s, const ulong dim, const uint j, const uint m, const Mask16 *on,
                                                        Point16 *out) {
#if PENUMBRA_ROWS
  uint16 element;
  if (elements16(s, j, m, &element)) {
    draw_row_2d(s, dim, &element, out);
    return;
  }
#endif
  out->x = out->y = 0.0f;
  for (LANES_OF(k, *on)) {
    const Sampler one = lane_sampler(s, k);
    const float2 u = sample_2d_of(&one, dim, j, m);
    LANE_F(out->x, k) = u.x;
    LANE_F(out->y, k) = u.y;
  }
}

// Number j of m that each sample draws.
static inline float16 sample_1d_of16(const Sampler16 *s, const ulong dim, const uint j, const uint m, const Mask16 on) {
  float16 out;
#if PENUMBRA_ROWS
  if (m == 1u && s->rows) {
    draw_row_1d(s, dim, &s->element, &out);
    return out;
  }
#endif
  draw_any_1d(s, dim, j, m, &on, &out);
  return out;
}

static inline Point16 sample_2d_of16(const Sampler16 *s, const ulong dim, const uint j, const uint m, const Mask16 on) {
  Point16 out;
#if PENUMBRA_ROWS
  if (m == 1u && s->rows) {
    draw_row_2d(s, dim, &s->element, &out);
    return out;
  }
#endif
  draw_any_2d(s, dim, j, m, &on, &out);
  return out;
}

static inline float16 sample_1d16(const Sampler16 *s, const ulong dim, const Mask16 on) { return sample_1d_of16(s, dim, 0u, 1u, on); }
static inline Point16 sample_2d16(const Sampler16 *s, const ulong dim, const Mask16 on) { return sample_2d_of16(s, dim, 0u, 1u, on); }

// A pair of each sample of some vectors, and of what follows it (SLOT_DIRECTION on SLOT_LIGHT), `count` of them a vector.
static inline void sample_pairs16(const Sampler16 *s, const Mask16 *on, const uint vectors, const ulong dim, const uint count, Point16 *p) {
#if PENUMBRA_ROWS && PENUMBRA_SAMPLER == SAMPLER_SOBOL
  bool rows = true;
  for (uint w = 0u; w < vectors; w++) rows = rows && s[w].rows;
  if (rows) {
    draw_pairs(s, vectors, dim, count, (const uint16 *)0, p);
    return;
  }
#endif
  for (uint w = 0u; w < vectors; w++)
    for (uint i = 0u; i < count; i++) p[w * count + i] = sample_2d16(s + w, dim + i * (SLOT_DIRECTION - SLOT_LIGHT), on[w]);
}
