// Spherical triangles (lights/spherical_triangle.cl) for sixteen lanes, each with the bits of its scalar twin.
#include "base/transcendental16.cl"
#include "lights/spherical_triangle.cl"

typedef struct {
  float16 a, b, c, cos_ac, g1, g2, r, half_angle;
} SphericalTriangle16;

static inline SphericalTriangle16 spherical_triangle16(const Vec16 a, const Vec16 b, const Vec16 c, const float16 volume) {
  SphericalTriangle16 t;
  t.a = length16(a);
  t.b = length16(b);
  t.c = length16(c);
  const Vec16 ua = scale16(a, 1.0f / t.a), ub = scale16(b, 1.0f / t.b), uc = scale16(c, 1.0f / t.c);
  t.cos_ac = dot16(ua, uc);
  t.g1 = t.cos_ac + dot16(ub, uc);
  t.g2 = 1.0f + dot16(ua, ub);
  const float16 d = volume / t.a / t.b / t.c;
  const float16 g = t.g1 + t.g2;
  t.r = sqrt16(d * d + g * g);
  t.half_angle = atan2_16(d, g);
  return t;
}

static inline float16 spherical_triangle_cut16(const SphericalTriangle16 *t, const float16 half_part) {
  const float16 zero = 0.0f, one = 1.0f, middle = 0.5f;
  float16 s_part, c_part, s_rest, c_rest;
  sincos_2pi16(half_part * INV_2PI_F, &s_part, &c_part);
  const float16 left = t->half_angle - half_part;
  sincos_2pi16(MAX16(left, zero) * INV_2PI_F, &s_rest, &c_rest);
  const float16 rest = t->r * s_rest;
  const float16 beta = t->g2 * s_part;
  const float16 alpha = rest + beta;
  const float16 to_a = rest * (alpha + beta) / t->a;
  const float16 weight = alpha + beta * t->cos_ac;
  const float16 to_c = 2.0f * beta * MAX16(weight, zero) / t->c;
  const float16 sum = to_a + to_c;
  const float16 share = to_c / sum;
  return sum > 0.0f ? MIN16(share, one) : middle;
}

static inline float16 spherical_triangle_reach16(const SphericalTriangle16 *t, const Vec16 b, const Vec16 e, const float16 v) {
  const float16 one = 1.0f;
  const float16 length_e = length16(e);
  const Vec16 difference = sub16(scale16(b, 1.0f / t->b), scale16(e, 1.0f / length_e));
  const float16 quarter = 0.25f * dot16(difference, difference);
  const float16 h = MIN16(quarter, one);
  const float16 g = v * h;
  const float16 root = sqrt16(v);
  const float16 near = sqrt16((1.0f - h) * (1.0f - g)) + h * root;
  const float16 to_b = (1.0f - v) / (sqrt16(1.0f - g) + sqrt16(v * (1.0f - h))) * near / t->b;
  const float16 to_e = root * sqrt16(1.0f - g) / length_e;
  const float16 sum = to_b + to_e;
  const float16 share = to_e / sum;
  return sum > 0.0f ? MIN16(share, one) : root;
}
