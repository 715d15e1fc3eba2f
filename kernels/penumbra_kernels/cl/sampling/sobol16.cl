// Owen-scrambled Sobol numbers in lanes: each gets the bits that sobol.cl gives its sample.
#include "sampling/hash16.cl"
#include "sampling/sobol.cl"

static inline uint16 reverse_bits16(const uint16 bits) {
  uint16 x = (bits >> 16u) | (bits << 16u);
  x = ((x >> 8u) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8u);
  x = ((x >> 4u) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4u);
  x = ((x >> 2u) & 0x33333333u) | ((x & 0x33333333u) << 2u);
  return ((x >> 1u) & 0x55555555u) | ((x & 0x55555555u) << 1u);
}

// A seed a lane: of one that all share a compiler makes what it needs.
static inline uint16 scramble_reversed16(uint16 x, const uint16 seed) {
  x ^= x * 0x3d20adeau;
  x += seed;
  x *= (seed >> 16u) | 1u;
  x ^= x * 0x05526c56u;
  x ^= x * 0x53a22864u;
  return x;
}

static inline uint16 pascal_reversed16(uint16 index) {
  index ^= index >> 16u;
  index ^= (index & 0xff00ff00u) >> 8u;
  index ^= (index & 0xf0f0f0f0u) >> 4u;
  index ^= (index & 0xccccccccu) >> 2u;
  return index ^ ((index & 0xaaaaaaaau) >> 1u);
}

// Indices after the dimension's shuffle, by its hashes.
static inline uint16 shuffled16(const uint16 index, const uint16 key) {
  return reverse_bits16(scramble_reversed16(reverse_bits16(index), key));
}

static inline float16 sobol_x16(const uint16 shuffled, const uint16 seed) {
  return uniform_of16(reverse_bits16(scramble_reversed16(shuffled, seed)));
}

static inline float16 sobol_y16(const uint16 shuffled, const uint16 seed) {
  return uniform_of16(reverse_bits16(scramble_reversed16(pascal_reversed16(shuffled), seed)));
}
