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

static inline uint16 scramble_reversed16(uint16 x, const uint16 seed) {
  x += seed;
  x *= (seed >> 16u) | 1u;
  return x ^ x * 0x53a22864u;
}

// Each byte times a matrix of 8 x 8 bits modulo 2, where the processor has an instruction for that (GFNI). A matrix's rows are bytes, the
// lowest bit's last.
#if PENUMBRA_512 && defined(__GFNI__)
#define REVERSED_BYTE 0x8040201008040201ul
#define PASCAL_BYTE 0xffaacc88f0a0c080ul
typedef char Bytes64 __attribute__((vector_size(64)));
static inline Bytes64 map_bytes(const Bytes64 x, const ulong matrix) {
  return __builtin_ia32_vgf2p8affineqb_v64qi(x, __builtin_astype((ulong8)(matrix), Bytes64), 0);
}

// Pascal's matrix is one of these for the bits of each byte times the same of 4 x 4 for the bytes.
static inline uint16 pascal_reversed16(const uint16 index) {
  uint16 x = __builtin_astype(map_bytes(__builtin_astype(index, Bytes64), PASCAL_BYTE), uint16);
  x ^= x >> 16u;
  return x ^ ((x & 0xff00ff00u) >> 8u);
}

// The 24 bits that uniform_of takes are turned round alone: the shuffle of bytes leaves 0 where it would shift.
static inline float16 uniform_of_reversed16(const uint16 x) {
  const uint4 turned = (uint4)(0x80000102u, 0x80040506u, 0x8008090au, 0x800c0d0eu);
  const uint16 order = (uint16)(turned, turned, turned, turned);
  const Bytes64 bytes = __builtin_ia32_pshufb512(__builtin_astype(x, Bytes64), __builtin_astype(order, Bytes64));
  return to_float16(__builtin_astype(map_bytes(bytes, REVERSED_BYTE), int16)) * 0x1p-24f;
}
#else
static inline uint16 pascal_reversed16(uint16 index) {
  index ^= index >> 16u;
  index ^= (index & 0xff00ff00u) >> 8u;
  index ^= (index & 0xf0f0f0f0u) >> 4u;
  index ^= (index & 0xccccccccu) >> 2u;
  return index ^ ((index & 0xaaaaaaaau) >> 1u);
}

static inline float16 uniform_of_reversed16(const uint16 x) { return uniform_of16(reverse_bits16(x)); }
#endif

static inline uint16 joined16(uint16 index) {
  index ^= (index & 0xccccccccu) >> 2u;
  index ^= index >> 6u;
  return index ^ ((index & 0xb6db6db6u) >> 5u);
}

// Reversed indices after their family's shuffle.
static inline uint16 shuffled16(const uint16 reversed, const uint16 key) { return reverse_bits16(scramble_reversed16(reversed, key)); }

static inline float16 sobol_x16(const uint16 shuffled, const uint16 seed) {
  return uniform_of_reversed16(scramble_reversed16(shuffled, seed));
}

static inline float16 sobol_y16(const uint16 shuffled, const uint16 seed) {
  return uniform_of_reversed16(scramble_reversed16(pascal_reversed16(shuffled), seed));
}
