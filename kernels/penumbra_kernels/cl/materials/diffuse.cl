// Lambertian reflection: color0 / pi.
#include "materials/bsdf.h"

static inline float3 diffuse_eval(const Bsdf *b, const float3 wi, float *pdf) {
  if (wi.z <= 0.0f) return (float3)(0.0f);
  *pdf = wi.z * INV_PI_F;
  return b->color0 * *pdf;
}

static inline bool diffuse_sample(const float2 u, BsdfSample *out) {
  smooth_event(out, cosine_direction(u));
  return true;
}
