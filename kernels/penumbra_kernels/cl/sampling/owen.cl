// The first two dimensions of the Sobol sequence, and Owen's nested uniform scrambling by hashing.
// Numbers in [0, 1) are kept as 32-bit fixed point; "reversed" means with the most significant bit in bit 0.
#include "base/math.cl"

#if PENUMBRA_BUILTINS
#define REVERSE_BITS(x) __builtin_bitreverse32(x)
#define REVERSE_BITS64(x) __builtin_bitreverse64(x)
#else
#define REVERSE_BITS(x) reverse_bits(x)
#define REVERSE_BITS64(x) (((ulong)reverse_bits((uint)(x)) << 32) | reverse_bits((uint)((x) >> 32)))
static inline uint reverse_bits(uint x) {
  x = (x >> 16) | (x << 16);
  x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
  x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
  x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
  return ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
}
#endif

// Scrambles a reversed number: each bit is flipped by a hash of the bits below it, the more significant ones. A hash in the
// manner of Laine and Karras (2011): what a seed has a part in, and the last step, of Vegdahl's (2021, "Building a Better LK Hash"),
// whose two other steps change no variance (decision 27).
static inline uint scramble_reversed(uint x, const uint seed) {
  x += seed;
  x *= (seed >> 16) | 1u;
  return x ^ x * 0x53a22864u;
}

// Of a number that is reversed already.
static inline uint owen_scramble_of(const uint reversed, const uint seed) {
  return REVERSE_BITS(scramble_reversed(reversed, seed));
}

static inline uint owen_scramble(const uint x, const uint seed) {
  return owen_scramble_of(REVERSE_BITS(x), seed);
}

// Second Sobol dimension of an index, reversed. The first dimension is the reversed index, so its own reversal is the index
// itself; the second is its product with the Pascal matrix modulo 2, which factors into one step for each bit of a bit's
// number (Ahmed 2024, "An Implementation Algorithm of 2D Sobol Sequence Fast, Elegant, and Compact", mirrored).
static inline uint pascal_reversed(uint index) {
  index ^= index >> 16;
  index ^= (index & 0xff00ff00u) >> 8;
  index ^= (index & 0xf0f0f0f0u) >> 4;
  index ^= (index & 0xccccccccu) >> 2;
  return index ^ ((index & 0xaaaaaaaau) >> 1);
}

// Another order of the same sequence: a linear map over bits whose aligned blocks of 2^m indices are those that they were. With the
// pair at the index itself it makes four dimensions, of which 2^m points miss evenness by t bits, where the first four dimensions of
// Joe and Kuo (2008) miss it by those in brackets: m 2: 1 (1), 3: 1 (2), 4: 2 (2), 5: 2 (2), 6: 1 (2), 7: 2 (2), 8: 2 (3),
// 10: 3 (2). Found by trying at random some 100,000 maps of up to three such steps.
static inline uint joined(uint index) {
  index ^= (index & 0xccccccccu) >> 2;
  index ^= index >> 6;
  return index ^ ((index & 0xb6db6db6u) >> 5);
}

// Owen-scrambled dimensions at an index: reversed numbers are what scrambling wants, so only the result is turned round.
static inline uint sobol_x(const uint index, const uint seed) { return REVERSE_BITS(scramble_reversed(index, seed)); }

static inline uint sobol_y(const uint index, const uint seed) {
  return REVERSE_BITS(scramble_reversed(pascal_reversed(index), seed));
}

// Both, turned round in one go: x in the high half.
static inline ulong sobol_xy(const uint index_x, const uint index_y, const uint seed_x, const uint seed_y) {
  const uint x = scramble_reversed(index_x, seed_x);
  const uint y = scramble_reversed(pascal_reversed(index_y), seed_y);
  return REVERSE_BITS64(((ulong)y << 32) | x);
}
