// fresnel.cl in sixteen lanes.
#include "base/lanes16.cl"

static inline float16 refraction_cosine2_16(const float16 c, const float16 eta) {
  const float16 e = eta * eta;
  const float16 e_error = fma16(eta, eta, -e);
  const float16 q = c * c;
  const float16 q_error = fma16(c, c, -q);
  const float16 d = e - 1.0f;
  const float16 d_error = e < 1.0f ? e - (d + 1.0f) : (float16)(0.0f);
  return (d + q) + (d_error + (e_error + q_error));
}

static inline float16 fresnel_dielectric16(const float16 c, const float16 eta, float16 *cos_t) {
  const float16 scaled2 = refraction_cosine2_16(c, eta);
  const Mask16 refracts = scaled2 > 0.0f;
  const float16 scaled = sqrt16(scaled2);
  const float16 cosine = scaled / eta;
  const float16 across = (c - scaled) / (c + scaled);
  const float16 along = (eta * c - cosine) / (eta * c + cosine);
  const float16 one = 1.0f, mean = 0.5f * (across * across + along * along);
  *cos_t = refracts ? cosine : (float16)(0.0f);
  return refracts ? MIN16(mean, one) : one;
}

static inline Vec16 fresnel_schlick16(const Vec16 f0, const float16 c) {
  const float16 m = 1.0f - clamp01_16(c);
  const float16 m2 = m * m;
  const float16 power = m2 * m2 * m;
  return vec16(f0.x + (1.0f - f0.x) * power, f0.y + (1.0f - f0.y) * power, f0.z + (1.0f - f0.z) * power);
}

static inline Vec16 refract_about16(const Vec16 wo, const Vec16 h, const float16 c, const float16 cos_t, const float16 eta) {
  const float16 inverse = 1.0f / eta;
  return sub16(scale16(h, c * inverse - cos_t), scale16(wo, inverse));
}
