// microfacet.cl in sixteen lanes.
#include "materials/bsdf16.h"

static inline float16 ggx_d16(const Vec16 m, const float16 ax, const float16 ay) {
  const float16 area = ax * ay;
  const float16 q = (ay / ax) * (m.x * m.x) + (ax / ay) * (m.y * m.y) + area * (m.z * m.z);
  return area / (PI_F * (q * q));
}

static inline float16 ggx_l16(const Vec16 w, const float16 ax, const float16 ay) {
  return sqrt16(w.z * w.z + sqr16(ax * w.x) + sqr16(ay * w.y));
}

static inline float16 ggx_g1_16(const Vec16 w, const float16 ax, const float16 ay) {
  const float16 z = abs16(w.z);
  return 2.0f * z / (z + ggx_l16(w, ax, ay));
}

static inline Vec16 ggx_sample_visible16(const Vec16 wo, const float16 ax, const float16 ay, const Point16 *at) {
  const Vec16 w = normalize16(vec16(ax * wo.x, ay * wo.y, wo.z));
  const float16 below = at->y * (1.0f + w.z);
  const float16 height = (1.0f - at->y) * (1.0f + w.z);
  const float16 sine = safe_sqrt16(below * (2.0f - below));
  float16 s, c;
  sincos_2pi16(at->x, &s, &c);
  return normalize16(vec16(ax * (sine * c + w.x), ay * (sine * s + w.y), height));
}

static inline float16 ggx_visible_pdf16(const Vec16 wo, const Vec16 m, const float16 ax, const float16 ay) {
  const float16 c = dot16(wo, m), zero = 0.0f;
  return 2.0f * ggx_d16(m, ax, ay) * MAX16(c, zero) / (wo.z + ggx_l16(wo, ax, ay));
}

static inline Vec16 reflect_about16(const Vec16 wo, const Vec16 m) { return sub16(scale16(m, 2.0f * dot16(wo, m)), wo); }

// The lanes that have one.
static inline Mask16 half_vector16(const Vec16 wo, const Vec16 wi, Vec16 *h) {
  const Vec16 sum = add16(wo, wi);
  const float16 length2 = dot16(sum, sum);
  *h = scale16(sum, 1.0f / sqrt16(length2));
  return length2 > 0.0f;
}

static inline float16 ggx_reflect16(const Bsdf16 *b, const Vec16 wi, const Vec16 h, float16 *pdf) {
  const float16 d = ggx_d16(h, b->alpha_x, b->alpha_y);
  const float16 lo = ggx_l16(b->wo, b->alpha_x, b->alpha_y);
  const float16 li = ggx_l16(wi, b->alpha_x, b->alpha_y);
  *pdf = d / (2.0f * (b->wo.z + lo));
  return d * wi.z / (2.0f * (b->wo.z * li + wi.z * lo));
}
