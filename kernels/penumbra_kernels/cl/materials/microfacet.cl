// GGX microfacets (Walter et al. 2007; anisotropic as in Heitz 2014), in the local frame, z the surface's normal.
// With L(w) = sqrt(z^2 + ax^2 x^2 + ay^2 y^2), Smith's Lambda is (L / z - 1) / 2: every formula below is written in z and L,
// so that none divides by a cosine that may vanish.
#include "materials/bsdf.h"

// Density of microfacet normals. Numerator and denominator are scaled by ax ay, and the cosine enters as m.z^2 beside
// m.x^2 + m.y^2: no 1 - cos^2, no power of a tangent, at most some 8 roundings.
static inline float ggx_d(const float3 m, const float ax, const float ay) {
  const float area = ax * ay;
  const float q = (ay / ax) * (m.x * m.x) + (ax / ay) * (m.y * m.y) + area * (m.z * m.z);
  return area / (PI_F * (q * q));
}

static inline float ggx_l(const float3 w, const float ax, const float ay) {
  return SQRT(w.z * w.z + sqr(ax * w.x) + sqr(ay * w.y));
}

// Smith's masking of one direction, G1 = 1 / (1 + Lambda) (Heitz 2014, eq. 43).
static inline float ggx_g1(const float3 w, const float ax, const float ay) {
  const float z = FABS(w.z);
  return 2.0f * z / (z + ggx_l(w, ax, ay));
}

// A normal out of those visible from wo (wo.z > 0), by spherical caps (Dupuy and Benyoub 2023, listing 3). Written with
// height = (1 - u.y)(1 + w.z), the z of their sum, and 1 - z = u.y (1 + w.z), so that the sine is free of cancellation and
// the normal never falls below the surface.
static inline float3 ggx_sample_visible(const float3 wo, const float ax, const float ay, const float2 u) {
  const float3 w = normalize3((float3)(ax * wo.x, ay * wo.y, wo.z));
  const float below = u.y * (1.0f + w.z);
  const float height = (1.0f - u.y) * (1.0f + w.z);
  const float sine = safe_sqrt(below * (2.0f - below));
  float s, c;
  sincos_2pi(u.x, &s, &c);
  return normalize3((float3)(ax * (sine * c + w.x), ay * (sine * s + w.y), height));
}

// Density of that normal per solid angle, D(m) G1(wo) dot(wo, m) / wo.z (Heitz 2018).
static inline float ggx_visible_pdf(const float3 wo, const float3 m, const float ax, const float ay) {
  return 2.0f * ggx_d(m, ax, ay) * MAX(dot3(wo, m), 0.0f) / (wo.z + ggx_l(wo, ax, ay));
}

// Reflected direction about the normal m.
static inline float3 reflect_about(const float3 wo, const float3 m) { return m * (2.0f * dot3(wo, m)) - wo; }

// The normal that reflects wo to wi, both above the surface; false where they are so grazing that it is lost.
static inline bool half_vector(const float3 wo, const float3 wi, float3 *h) {
  const float3 sum = wo + wi;
  const float length2 = dot3(sum, sum);
  if (!(length2 > 0.0f)) return false;
  *h = sum * (1.0f / SQRT(length2));
  return true;
}

// Reflection with Fresnel 1 about the half vector h, times the cosine of wi: D G2 / (4 wo.z), with the height-correlated
// Smith term G2 = 1 / (1 + Lambda(wo) + Lambda(wi)) (Heitz 2014, eq. 99). *pdf: D_visible(h) / (4 dot(wo, h)).
// Their quotient is G2 / G1(wo) <= 1.
static inline float ggx_reflect(const Bsdf *b, const float3 wi, const float3 h, float *pdf) {
  const float d = ggx_d(h, b->alpha_x, b->alpha_y);
  const float lo = ggx_l(b->wo, b->alpha_x, b->alpha_y);
  const float li = ggx_l(wi, b->alpha_x, b->alpha_y);
  *pdf = d / (2.0f * (b->wo.z + lo));
  return d * wi.z / (2.0f * (b->wo.z * li + wi.z * lo));
}
