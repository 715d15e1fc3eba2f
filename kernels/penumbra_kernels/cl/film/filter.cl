// Reconstruction filters by filter importance sampling (Ernst, Stamminger, Greiner 2006): a sample's position follows the
// filter's absolute value, so that every sample counts the same and pixels stay independent of each other.
// Lengths in pixels from the pixel's centre.
#include "sampling/warp.cl"

// One axis: the table holds the right half of a symmetric filter, in units of its radius.
static inline float filter_axis(const __global float *table, const float u, float *sign) {
  const float side = 2.0f * u - 1.0f;
  return copy_sign(sample_table(table, FABS(side), sign), side);
}

// Offset from the pixel's centre for a point u of the unit square. weight: the filter's sign there times the constant
// (integral of |f| / integral of f)^2 that makes the mean of weighted samples the filtered picture; 1 for filters
// without negative lobes. Filters are separable: f(x) f(y).
static inline float2 filter_sample(const __global float *filter_table, const float radius, const float2 u,
                                   float *weight) {
  float sign_x, sign_y;
  const float x = filter_axis(filter_table, u.x, &sign_x);
  const float y = filter_axis(filter_table, u.y, &sign_y);
  *weight = sign_x * sign_y * filter_table[1];
  return (float2)(x * radius, y * radius);
}
