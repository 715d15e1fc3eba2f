// sampling/strata.cl in lanes, of elements that lie in one block: its count and name are those of all lanes.
#include "sampling/hash16.cl"
#include "sampling/strata.cl"

static inline uint16 round_bits16(const uint16 other, const ulong16 key, const uint round) {
  uint16 x = (other ^ to_uint16(key >> (ulong)(4u * round))) * 0x9e3779b1u;
  x = (x ^ (x >> 15u)) * 0x85ebca77u + high_half16(key);
  return (x ^ (x >> 13u)) * 0xc2b2ae3du >> 16u;
}

static inline uint16 permute_bits16(const uint16 x, const uint bits, const ulong16 key) {
  const uint low_bits = bits >> 1;
  const uint low_mask = (1u << low_bits) - 1u;
  const uint high_mask = (1u << (bits - low_bits)) - 1u;
  uint16 low = x & low_mask;
  uint16 high = x >> low_bits;
  for (uint round = 0u; round < 8u; round += 2u) {
    high ^= round_bits16(low, key, round) & high_mask;
    low ^= round_bits16(high, key, round + 1u) & low_mask;
  }
  return (high << low_bits) | low;
}

// Numbers i < count. Where count is SMALL_COUNT or less all lanes have the first one's key.
static inline uint16 permute16(const uint16 i, const uint count, const ulong16 key) {
  if (count <= SMALL_COUNT) {
    const ulong16 order = small_order(count, ((const ulong *)&key)[0]);
    return to_uint16(order >> to_ulong16(4u * i)) & 15u;
  }
  const uint bits = bits_of(count);
  uint16 x = permute_bits16(i, bits, key);
  for (Mask16 far = x >= count; any16(far); far = x >= count) x = far ? permute_bits16(x, bits, key) : x;
  return x;
}

static inline float16 stratum_1d16(const uint16 at, const uint count, const float16 jitter) {
  const float16 u = (to_float16(as_int16(at)) + jitter) / (float)count, most = ONE_MINUS_EPSILON;
  return MIN16(u, most);
}

// Quotients are exact: of whole numbers below 2^24 a float's is never rounded up to the next whole number.
static inline Point16 stratum_2d16(const uint16 at, const uint count, const Point16 jitter) {
  const uint rows = MAX(nearest_root(count), 1u);
  const uint base = count / rows;
  const uint longer = count - base * rows;
  const uint in_longer = longer * (base + 1u);
  const Mask16 is_longer = at < in_longer;
  const uint16 cells = is_longer ? (uint16)(base + 1u) : (uint16)(base);
  const uint16 rest = is_longer ? at : at - in_longer;
  const float16 along = to_float16(as_int16(cells));
  const uint16 row = as_uint16(to_int16(to_float16(as_int16(rest)) / along));
  const uint16 column = rest - row * cells;
  const uint16 before = (is_longer ? (uint16)(0u) : (uint16)(in_longer)) + row * cells;
  const float16 most = ONE_MINUS_EPSILON;
  Point16 p;
  p.x = (to_float16(as_int16(column)) + jitter.x) / along;
  p.y = (to_float16(as_int16(before)) + jitter.y * along) / (float)count;
  p.x = MIN16(p.x, most);
  p.y = MIN16(p.y, most);
  return p;
}
