// Maps of sampling/warp.cl for sixteen lanes, each with the bits of its scalar twin. Points (x, y) of the unit square.
#include "base/lanes16.cl"
#include "sampling/warp.cl"

static inline float16 centered16(const float16 u) { return fma16(2.0f, u, -1.0f + 0x1p-24f); }

static inline void square_to_disc16(const float16 ux, const float16 uy, float16 *x, float16 *y) {
  const float16 a = centered16(ux), b = centered16(uy);
  const Mask16 wide = abs16(a) > abs16(b);
  const float16 r = wide ? a : b;
  float16 s, c;
  sincos_near16(0.5f * ((wide ? b : a) / r), &s, &c);
  const float16 along = r * c, across = r * s;
  *x = wide ? along : across;
  *y = wide ? across : along;
}

static inline Vec16 square_to_cosine_hemisphere16(const float16 ux, const float16 uy, float16 *pdf) {
  Vec16 d;
  square_to_disc16(ux, uy, &d.x, &d.y);
  const float16 a = abs16(centered16(ux)), b = abs16(centered16(uy));
  const float16 r = MAX16(a, b);
  d.z = sqrt16((1.0f - r) * (1.0f + r));
  *pdf = d.z * INV_PI_F;
  return d;
}

static inline float16 cosine_hemisphere_pdf16(const float16 cos_theta) {
  return MAX16(cos_theta, (float16)(0.0f)) * INV_PI_F;
}

static inline Vec16 square_to_sphere16(const float16 ux, const float16 uy) {
  const float16 z = centered16(ux);
  const float16 sine = sqrt16((1.0f - z) * (1.0f + z));
  float16 s, c;
  sincos_2pi16(uy, &s, &c);
  return vec16(sine * c, sine * s, z);
}
