// independent: random numbers with nothing between them. random: the same within a pixel, with a random number of points in
// it (the host's binomial split, sampling/random_plane.py, says how many).
#include "sampling/strata.cl"

static inline float independent_1d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  return uniform_of((uint)(hash_combine(hash_combine(s->key, dimension), element) >> 32));
}

static inline float2 independent_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  return uniform_pair(hash_combine(hash_combine(s->key, dimension), element));
}
