// phong.cl in sixteen lanes.
#include "base/transcendental16.cl"
#include "materials/bsdf16.h"

static inline float16 log1p_below16(const float16 x) {
  const float16 y = 1.0f + x;
  return y == 1.0f ? x : log16(y) * (x / (y - 1.0f));
}

static inline float16 expm1_below16(const float16 x) {
  const float16 y = exp16(x), least = -1.0f;
  const float16 wide = y > 0.0f ? (y - 1.0f) * (x / log16(y)) : least;
  return y == 1.0f ? x : wide;
}

static inline void phong_start16(const Mask16 on, Bsdf16 *b) {
  limit_sum16(on, b);
  const float16 base = max3_16(b->color0), cone = max3_16(b->color1), zero = 0.0f;
  const float16 share = base + cone > 0.0f ? cone / (base + cone) : zero;
  b->lobe = on ? share : b->lobe;
}

static inline float16 phong_power16(const Bsdf16 *b, const Vec16 wi) {
  const Vec16 d = sub16(wi, mirror_of16(b->wo));
  const float16 below = 0.5f * dot16(d, d), zero = 0.0f;
  return below >= 1.0f ? zero : exp16(b->exponent * log1p_below16(-below));
}

static inline Vec16 phong_eval16(const Bsdf16 *b, const Vec16 wi, float16 *pdf) {
  const float16 zero = 0.0f;
  const Mask16 below = wi.z <= 0.0f;
  const float16 power = phong_power16(b, wi) * INV_2PI_F;
  const float16 cosine = wi.z * INV_PI_F;
  *pdf = below ? zero : (1.0f - b->lobe) * cosine + b->lobe * ((b->exponent + 1.0f) * power);
  const float16 cone = (b->exponent + 2.0f) * power * wi.z;
  return where16(below, vec16(zero, zero, zero), add16(scale16(b->color0, cosine), scale16(b->color1, cone)));
}

static inline Vec16 phong_cone16(const Bsdf16 *b, const Point16 *at) {
  const float16 below = -expm1_below16(log1p_below16(-at->x) / (b->exponent + 1.0f));
  const float16 sine = safe_sqrt16(below * (2.0f - below));
  float16 s, c;
  sincos_2pi16(at->y, &s, &c);
  const Vec16 axis = mirror_of16(b->wo);
  Vec16 x, y;
  make_frame16(axis, &x, &y);
  return add16(add16(scale16(x, sine * c), scale16(y, sine * s)), scale16(axis, 1.0f - below));
}

static inline Mask16 phong_sample16(const Bsdf16 *b, Point16 at, const Mask16 on, BsdfSample16 *out) {
  const Mask16 cone = takes_lobe16(b->lobe, &at);
  smooth_event16(on, where16(cone, phong_cone16(b, &at), cosine_direction16(&at)), out);
  return on & (out->event == 0u);
}
