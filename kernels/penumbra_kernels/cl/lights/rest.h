// What is left of a random point once its first number has chosen a light: a point of that light's own. What spreads points
// evenly over the square spreads each light's own evenly too.
// Uniform numbers have 24 bits, and a light that one in a million chooses has few of them: the others are filled up with
// digits of the point's second number, so that the first takes as many values as ever.
#include "base/math.cl"

// Digits of a uniform number behind its first 12 bits, as a number in [0, 1).
static inline float digits_behind(const float u) {
  const float scaled = u * 0x1p12f;
  return scaled - (float)(int)scaled;
}

// Number `at` of `numbers` neighbouring ones, as a number in [0, 1).
static inline float place_among(const float at, const float numbers, const float digits) {
  return MIN((at + digits) / numbers, ONE_MINUS_EPSILON);
}
