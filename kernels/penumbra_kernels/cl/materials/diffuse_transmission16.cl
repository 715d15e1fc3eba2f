// diffuse_transmission.cl in sixteen lanes.
#include "materials/bsdf16.h"

static inline void diffuse_transmission_start16(const Mask16 on, Bsdf16 *b) {
  limit_sum16(on, b);
  const float16 reflect = max3_16(b->color0), transmit = max3_16(b->color1), one = 1.0f;
  const float16 share = reflect + transmit > 0.0f ? reflect / (reflect + transmit) : one;
  b->lobe = on ? share : b->lobe;
}

static inline Vec16 diffuse_transmission_eval16(const Bsdf16 *b, const Vec16 wi, float16 *pdf) {
  const float16 cosine = abs16(wi.z) * INV_PI_F;
  const Mask16 reflects = wi.z > 0.0f;
  *pdf = (reflects ? b->lobe : 1.0f - b->lobe) * cosine;
  return scale16(where16(reflects, b->color0, b->color1), cosine);
}

static inline Mask16 diffuse_transmission_sample16(const Bsdf16 *b, Point16 at, const Mask16 on, BsdfSample16 *out) {
  const Mask16 reflects = takes_lobe16(b->lobe, &at);
  Vec16 wi = cosine_direction16(&at);
  wi.z = reflects ? wi.z : -wi.z;
  smooth_event16(on, wi, out);
  return on;
}
