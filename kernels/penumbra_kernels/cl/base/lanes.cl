// Comparisons of eight lanes at once, for the trees of geometry and lights. No lengths, no frame.
#include "base/types.h"

#define MIN8(a, b) ((a) < (b) ? (a) : (b))
#define MAX8(a, b) ((a) > (b) ? (a) : (b))

// One bit a lane, set where the comparison held.
#if PENUMBRA_X86 && defined(__AVX__)
static inline uint lane_mask(const int8 m) { return (uint)__builtin_ia32_movmskps256(as_float8(m)); }
#else
static inline uint lane_mask(const int8 m) {
  const int8 bits = m & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
  const int4 four = bits.lo | bits.hi;
  const int2 two = four.lo | four.hi;
  return (uint)(two.x | two.y);
}
#endif
