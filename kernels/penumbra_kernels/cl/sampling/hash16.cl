// base/hash.cl in lanes.
#include "base/hash.cl"
#include "base/lanes16.cl"

static inline float16 uniform_of16(const uint16 bits) { return to_float16(as_int16(bits >> 8u)) * 0x1p-24f; }

static inline ulong16 mix64_16(ulong16 x) {
  x ^= x >> 30ul;
  x *= 0xbf58476d1ce4e5b9ul;
  x ^= x >> 27ul;
  x *= 0x94d049bb133111ebul;
  return x ^ (x >> 31ul);
}

static inline ulong16 hash_combine16(const ulong16 key, const ulong value) { return mix64_16(key + HASH_STEP * (value + 1ul)); }

// Of eight keys.
static inline ulong8 mix64_8(ulong8 x) {
  x ^= x >> 30ul;
  x *= 0xbf58476d1ce4e5b9ul;
  x ^= x >> 27ul;
  x *= 0x94d049bb133111ebul;
  return x ^ (x >> 31ul);
}

static inline ulong8 hash_combine8(const ulong8 key, const ulong value) { return mix64_8(key + HASH_STEP * (value + 1ul)); }

static inline uint16 low_half16(const ulong16 x) { return to_uint16(x); }
static inline uint16 high_half16(const ulong16 x) { return to_uint16(x >> 32ul); }
