// Paper, leaves, lampshades: Lambertian on both sides, color0 reflected, color1 transmitted. Their sum is at most 1.
// `lobe` is the probability of reflection.
#include "materials/bsdf.h"

static inline void diffuse_transmission_start(Bsdf *b) {
  const float3 sum = b->color0 + b->color1;
  // Textures may ask for more than there is: scale both down, channel by channel.
  const float3 scale = (float3)(1.0f / MAX(sum.x, 1.0f), 1.0f / MAX(sum.y, 1.0f), 1.0f / MAX(sum.z, 1.0f));
  b->color0 *= scale;
  b->color1 *= scale;
  const float reflect = max3(b->color0), transmit = max3(b->color1);
  b->lobe = reflect + transmit > 0.0f ? reflect / (reflect + transmit) : 1.0f;
}

static inline float3 diffuse_transmission_eval(const Bsdf *b, const float3 wi, float *pdf) {
  const float cosine = FABS(wi.z) * INV_PI_F;
  *pdf = (wi.z > 0.0f ? b->lobe : 1.0f - b->lobe) * cosine;
  return (wi.z > 0.0f ? b->color0 : b->color1) * cosine;
}

static inline bool diffuse_transmission_sample(const Bsdf *b, float2 u, BsdfSample *out) {
  const bool reflects = takes_lobe(b->lobe, &u);
  float3 wi = cosine_direction(u);
  if (!reflects) wi.z = -wi.z;
  smooth_event(out, wi);
  return true;
}
