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

// scramble_reversed begins with what no seed has a part in. A seed a lane: of one that all share a compiler makes what it needs.
static inline uint16 scramble_start16(const uint16 x) { return x ^ x * 0x3d20adeau; }
static inline uint16 scramble_end16(uint16 x, const uint16 seed) {
  x += seed;
  x *= (seed >> 16u) | 1u;
  x ^= x * 0x05526c56u;
  x ^= x * 0x53a22864u;
  return x;
}
static inline uint16 scramble_reversed16(const uint16 x, const uint16 seed) { return scramble_end16(scramble_start16(x), seed); }

static inline uint16 pascal_reversed16(uint16 index) {
  index ^= index >> 16u;
  index ^= (index & 0xff00ff00u) >> 8u;
  index ^= (index & 0xf0f0f0f0u) >> 4u;
  index ^= (index & 0xccccccccu) >> 2u;
  return index ^ ((index & 0xaaaaaaaau) >> 1u);
}

static inline uint16 joined16(uint16 index) {
  index ^= (index & 0xccccccccu) >> 2u;
  index ^= index >> 6u;
  return index ^ ((index & 0xb6db6db6u) >> 5u);
}

// Indices before a dimension's shuffle, which is the same for all dimensions, and after it, by its hashes.
static inline uint16 shuffle_start16(const uint16 index) { return scramble_start16(reverse_bits16(index)); }
static inline uint16 shuffled16(const uint16 start, const uint16 key) { return reverse_bits16(scramble_end16(start, key)); }

static inline float16 sobol_x16(const uint16 shuffled, const uint16 seed) {
  return uniform_of16(reverse_bits16(scramble_reversed16(shuffled, seed)));
}

static inline float16 sobol_y16(const uint16 shuffled, const uint16 seed) {
  return uniform_of16(reverse_bits16(scramble_reversed16(pascal_reversed16(shuffled), seed)));
}
