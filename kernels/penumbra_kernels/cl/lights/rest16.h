// lights/rest.h in lanes.
#include "base/lanes16.cl"
#include "lights/rest.h"

static inline float16 digits_behind16(const float16 u) {
  const float16 scaled = u * 0x1p12f;
  return scaled - to_float16(to_int16(scaled));
}

static inline float16 place_among16(const float16 at, const float16 numbers, const float16 digits) {
  const float16 place = (at + digits) / numbers, most = ONE_MINUS_EPSILON;
  return MIN16(place, most);
}
