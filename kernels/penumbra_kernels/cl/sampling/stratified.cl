// jittered: a random point in each stratum, in every domain (x_p - 0.5 + xi). stratified: the pixel is sampled at the strata's
// centres (x = x_p), every other domain as jittered. Dimensions are padded: each has its own permutation of the strata.
#include "sampling/strata.cl"

static inline ulong block_key(const Sampler *s, const ulong dimension, const Stratum t) {
  return hash_combine(hash_combine(s->key, dimension), t.block);
}

static inline float jittered_1d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const Stratum t = stratum_of(element, strata);
  const ulong key = block_key(s, dimension, t);
  const float jitter = uniform_of((uint)(hash_combine(key, t.offset) >> 32));
  return stratum_1d(permute(t.offset, t.count, key), t.count, jitter);
}

static inline float2 jittered_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const Stratum t = stratum_of(element, strata);
  const ulong key = block_key(s, dimension, t);
  return stratum_2d(permute(t.offset, t.count, key), t.count, uniform_pair(hash_combine(key, t.offset)));
}

static inline float2 stratified_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  if (dimension != DIM_PIXEL) return jittered_2d(s, dimension, element, strata);
  const Stratum t = stratum_of(element, strata);
  return stratum_2d(permute(t.offset, t.count, block_key(s, dimension, t)), t.count, (float2)(0.5f));
}
