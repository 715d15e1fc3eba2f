// sobol (default): the two-dimensional Sobol sequence, Owen-scrambled, once for each dimension; dimensions are padded by
// scrambling the index as well (Burley 2020, "Practical Hash-based Owen Scrambling", section 5). Any dimension and
// any 64-bit index works: each 2^32 elements start a sequence of their own.
// What the first hit sends to lights or into lobes depends on where in the pixel it lies: these pairs share the pixel's shuffle, and
// the pixel takes its points in another order of the same sequence (joined), so that pixel and light, and pixel and direction, are
// spread over four dimensions too. Each pair by itself is what it was.
#include "base/dimensions.h"
#include "sampling/strata.cl"
#include "sampling/owen.cl"

static inline ulong sobol_key(const Sampler *s, const ulong dimension, const ulong element) {
  const ulong key = hash_combine(s->key, dimension);
  const ulong epoch = element >> 32;
  return epoch ? hash_combine(key, epoch) : key;
}

// The element's place after its dimension's own shuffle. Nearly always the element is the sample's index.
static inline uint sobol_shuffled(const Sampler *s, const ulong element, const ulong key) {
  return owen_scramble_of(element == s->index ? s->reversed : REVERSE_BITS((uint)element), (uint)key);
}

// The dimension whose shuffle a pair takes.
static inline ulong shuffle_of(const ulong dimension) {
  return dimension == DIM_BOUNCE(0u, SLOT_LIGHT) || dimension == DIM_BOUNCE(0u, SLOT_DIRECTION) ? DIM_PIXEL : dimension;
}

static inline float sobol_1d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const ulong key = sobol_key(s, dimension, element);
  const uint shuffled = sobol_shuffled(s, element, key);
  return uniform_of(sobol_x(shuffled, (uint)(key >> 32)));
}

static inline float2 sobol_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const ulong key = sobol_key(s, dimension, element);
  const ulong more = mix64(key);
  const ulong shuffle = shuffle_of(dimension);
  uint shuffled = sobol_shuffled(s, element, shuffle == dimension ? key : sobol_key(s, shuffle, element));
  if (dimension == DIM_PIXEL) shuffled = joined(shuffled);
  const ulong xy = sobol_xy(shuffled, shuffled, (uint)(more >> 32), (uint)more);
  return (float2)(uniform_of((uint)(xy >> 32)), uniform_of((uint)xy));
}
