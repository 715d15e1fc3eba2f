// sobol (default): the two-dimensional Sobol sequence, Owen-scrambled, once for each dimension; dimensions are padded by
// scrambling the index as well (Burley 2020, "Practical Hash-based Owen Scrambling", section 5). Any dimension and
// any 64-bit index works: each 2^32 elements start a sequence of their own.
// What a hit sends to lights and into lobes is added up, so that these pairs may share a shuffle. At the first hit they depend on where
// in the pixel it lies: there they share the pixel's, and the pixel takes its points in another order of the same sequence (joined),
// so that pixel and light, and pixel and direction, are spread over four dimensions too. Each pair by itself is what it was.
#include "base/dimensions.h"
#include "sampling/strata.cl"
#include "sampling/owen.cl"

// The dimension whose shuffle and key a pair takes.
static inline ulong family_of(const ulong dimension) {
  if (dimension == DIM_BOUNCE(0u, SLOT_LIGHT) || dimension == DIM_BOUNCE(0u, SLOT_DIRECTION)) return DIM_PIXEL;
  return (dimension & 15ul) == SLOT_DIRECTION ? dimension - SLOT_DIRECTION + SLOT_LIGHT : dimension;
}

// Upper halves of a key's successive states scramble: the first number of a pair, the second, those of the family's next pair. A
// congruential generator, whose multiplier is one of Steele and Vigna's (2022, "Computationally easy, spectrally good multipliers for
// congruential pseudorandom number generators", table 5).
#define NEXT_SEED 0xd1342543de82ef95ul
#define NEXT_PAIR (NEXT_SEED * NEXT_SEED)

// From the family's key to the pair's first state.
static inline ulong pair_step(const ulong dimension) {
  if (dimension == DIM_BOUNCE(0u, SLOT_DIRECTION)) return NEXT_PAIR * NEXT_PAIR;
  return dimension == DIM_BOUNCE(0u, SLOT_LIGHT) || (dimension & 15ul) == SLOT_DIRECTION ? NEXT_PAIR : 1ul;
}

static inline ulong sobol_key(const Sampler *s, const ulong family, const ulong element) {
  const ulong key = hash_combine(s->key, family);
  const ulong epoch = element >> 32;
  return epoch ? hash_combine(key, epoch) : key;
}

// The element's place after its family's shuffle. Nearly always the element is the sample's index.
static inline uint sobol_shuffled(const Sampler *s, const ulong element, const ulong key) {
  return owen_scramble_of(element == s->index ? s->reversed : REVERSE_BITS((uint)element), (uint)key);
}

static inline float sobol_1d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const ulong key = sobol_key(s, dimension, element);
  return uniform_of(sobol_x(sobol_shuffled(s, element, key), (uint)(key >> 32)));
}

static inline float2 sobol_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const ulong key = sobol_key(s, family_of(dimension), element), state = key * pair_step(dimension);
  uint shuffled = sobol_shuffled(s, element, key);
  if (dimension == DIM_PIXEL) shuffled = joined(shuffled);
  const ulong xy = sobol_xy(shuffled, shuffled, (uint)(state >> 32), (uint)(state * NEXT_SEED >> 32));
  return (float2)(uniform_of((uint)(xy >> 32)), uniform_of((uint)xy));
}
