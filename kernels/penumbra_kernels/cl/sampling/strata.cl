// Strata: which cell of a partition of [0, 1) or [0, 1)^2 an element of a sequence falls into. Any number of cells, all of
// equal size, so that one point in each is unbiased.
#include "sampling/sampler.h"
#include "base/math.cl"

// Float points resolve no more cells than this; longer blocks are split.
#define MAX_STRATA (1u << 24)

// Element `offset` of a block of `count` elements that fill `count` strata; `block` names it.
typedef struct {
  ulong block;
  uint offset;
  uint count;
} Stratum;

// Planned: blocks of `strata`. Unknown (0): elements 0 and 1 alone, then blocks [2^k, 2^(k+1)) of 2^k strata.
static inline Stratum stratum_of(const ulong element, const uint strata) {
  Stratum s;
  if (strata > 0u) {
    s.count = MIN(strata, MAX_STRATA);
    s.block = element < s.count ? 0ul : element / s.count;
    s.offset = (uint)(element - s.block * s.count);
    return s;
  }
  const uint level = element > 1ul ? 63u - CLZ64(element) : 0u;
  s.count = 1u << MIN(level, 24u);
  const ulong within = element > 1ul ? element - (1ul << level) : 0ul;
  const ulong part = within / s.count;
  s.block = element > 1ul ? ((ulong)level << 48) + part : element << 63;
  s.offset = (uint)(within - part * s.count);
  return s;
}

// Number of bits that hold 0 ... count - 1.
static inline uint bits_of(const uint count) { return count > 1u ? 32u - CLZ(count - 1u) : 0u; }

#define SMALL_COUNT 16u

// A shuffle of up to 16 numbers, exact (Fisher and Yates; Durstenfeld 1964), a nibble each.
static inline ulong small_order(const uint count, ulong key) {
  ulong order = 0xfedcba9876543210ul;
  for (uint j = count - 1u; j > 0u; --j) {
    key = key * 0xd1342543de82ef95ul + HASH_STEP;  // a congruential generator of 64 bits, whose high ones are used
    const uint k = (uint)(((key >> 32) * (j + 1u)) >> 32);
    const ulong swap = ((order >> (4u * j)) ^ (order >> (4u * k))) & 15ul;
    order ^= (swap << (4u * j)) | (j == k ? 0ul : swap << (4u * k));
  }
  return order;
}

// What a round of the network below adds: 32 bits hashed with the round's slice of the key.
static inline uint round_bits(const uint other, const ulong key, const uint round) {
  uint x = (other ^ (uint)(key >> (4u * round))) * 0x9e3779b1u;
  x = (x ^ (x >> 15)) * 0x85ebca77u + (uint)(key >> 32);
  return (x ^ (x >> 13)) * 0xc2b2ae3du >> 16;
}

// A permutation of [0, 2^bits), bits <= 24, that the key picks: a Feistel network of the two halves of the bits (Luby and
// Rackoff 1988).
static inline uint permute_bits(const uint x, const uint bits, const ulong key) {
  const uint low_bits = bits >> 1;
  const uint low_mask = (1u << low_bits) - 1u;
  const uint high_mask = (1u << (bits - low_bits)) - 1u;
  uint low = x & low_mask;
  uint high = x >> low_bits;
  for (uint round = 0u; round < 8u; round += 2u) {
    high ^= round_bits(low, key, round) & high_mask;
    low ^= round_bits(high, key, round + 1u) & low_mask;
  }
  return (high << low_bits) | low;
}

// A permutation of [0, count) that the key picks. Large ones walk along a cycle of a permutation of the next power of two
// until they are back within range (Black and Rogaway 2002), fewer than two steps on average.
static inline uint permute(const uint i, const uint count, const ulong key) {
  if (count <= SMALL_COUNT) return (uint)(small_order(count, key) >> (4u * i)) & 15u;
  const uint bits = bits_of(count);
  uint x = i;
  do x = permute_bits(x, bits, key);
  while (x >= count);
  return x;
}

// The number `at` + jitter of `count` equal steps of [0, 1); jitter in [0, 1).
static inline float stratum_1d(const uint at, const uint count, const float jitter) {
  return MIN(((float)at + jitter) / (float)count, ONE_MINUS_EPSILON);
}

// floor(sqrt(count) + 1/2), exactly.
static inline uint nearest_root(const uint count) {
  uint root = (uint)SQRT((float)count);
  while (root * root + root < count) root++;          // count > (root + 1/2)^2 - 1/4
  while (root * root - root >= count) root--;
  return root;
}

// Cell `at` of `count` cells of equal area, in rows as near to a square grid as `count` allows: rows differ by at most one
// in their number of cells, and a row's height is its share of the cells.
static inline float2 stratum_2d(const uint at, const uint count, const float2 jitter) {
  const uint rows = MAX(nearest_root(count), 1u);
  const uint base = count / rows;
  const uint longer = count - base * rows;               // rows with one cell more, which come first
  const uint in_longer = longer * (base + 1u);
  const bool is_longer = at < in_longer;
  const uint cells = is_longer ? base + 1u : base;
  const uint rest = is_longer ? at : at - in_longer;
  const uint row = rest / cells;
  const uint column = rest - row * cells;
  const uint before = (is_longer ? 0u : in_longer) + row * cells;
  const float x = ((float)column + jitter.x) / (float)cells;
  const float y = ((float)before + jitter.y * (float)cells) / (float)count;
  return (float2)(MIN(x, ONE_MINUS_EPSILON), MIN(y, ONE_MINUS_EPSILON));
}

// Two uniform numbers from one 64-bit hash.
static inline float2 uniform_pair(const ulong bits) {
  return (float2)(uniform_of((uint)(bits >> 32)), uniform_of((uint)bits));
}
