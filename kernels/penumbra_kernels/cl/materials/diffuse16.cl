// diffuse.cl in sixteen lanes.
#include "materials/bsdf16.h"

static inline Vec16 diffuse_eval16(const Bsdf16 *b, const Vec16 wi, float16 *pdf) {
  const float16 zero = 0.0f;
  *pdf = wi.z <= 0.0f ? zero : wi.z * INV_PI_F;
  const Vec16 value = scale16(b->color0, *pdf);
  return where16(wi.z <= 0.0f, vec16(zero, zero, zero), value);
}

static inline Mask16 diffuse_sample16(const Mask16 on, const Point16 *at, BsdfSample16 *out) {
  smooth_event16(on, cosine_direction16(at), out);
  return on;
}
