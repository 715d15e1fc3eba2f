// Reflectance and refraction at an interface of two dielectrics. eta is the index of refraction of the far side over that
// of the side on which the cosine is measured.
#include "base/types.h"

// eta^2 - 1 + c^2, which is eta^2 times the squared cosine of refraction, to a relative error of some 2^-23 even where it
// nearly vanishes, at the critical angle of eta < 1: both squares and the difference from 1 are taken with their rounding
// errors (fma; Fast2Sum, Dekker 1971, since 1 >= eta^2 there), and the leading parts that then cancel do so exactly.
static inline float refraction_cosine2(const float c, const float eta) {
  const float e = eta * eta;
  const float e_error = FMA(eta, eta, -e);
  const float q = c * c;
  const float q_error = FMA(c, c, -q);
  const float d = e - 1.0f;
  const float d_error = e < 1.0f ? e - (d + 1.0f) : 0.0f;
  return (d + q) + (d_error + (e_error + q_error));
}

// Unpolarised Fresnel reflectance for a cosine c in [0, 1] (Walter et al. 2007, eq. 22, in Born and Wolf's amplitudes).
// *cos_t: cosine of the refracted direction, 0 at and beyond the critical angle, where the reflectance is 1.
static inline float fresnel_dielectric(const float c, const float eta, float *cos_t) {
  const float scaled2 = refraction_cosine2(c, eta);
  if (!(scaled2 > 0.0f)) {
    *cos_t = 0.0f;
    return 1.0f;
  }
  const float scaled = SQRT(scaled2);  // eta cos_t
  *cos_t = scaled / eta;
  const float across = (c - scaled) / (c + scaled);
  const float along = (eta * c - *cos_t) / (eta * c + *cos_t);
  return MIN(0.5f * (across * across + along * along), 1.0f);
}

// Schlick 1994, between f0 and white.
static inline float3 fresnel_schlick(const float3 f0, const float c) {
  const float m = 1.0f - CLAMP01(c);
  const float m2 = m * m;
  return f0 + ((float3)(1.0f) - f0) * (m2 * m2 * m);
}

// wo refracted about the normal h, with c = dot(wo, h) > 0 (Walter et al. 2007, eq. 40).
static inline float3 refract_about(const float3 wo, const float3 h, const float c, const float cos_t, const float eta) {
  const float inverse = 1.0f / eta;
  return h * (c * inverse - cos_t) - wo * inverse;
}
